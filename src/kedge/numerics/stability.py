"""How long a step an explicit rule can take."""

import numpy as np
from jaxtyping import Complex

RULES = ("rk4", "euler")
GROWTH = 0.1
"""What a rule may add to how fast a mode grows; 1/s."""


def longest_step(rule: str, modes: Complex[np.ndarray, " n"]) -> float:
    r"""The longest step h in s with which a rule is still stable for modes $\lambda$ (1/s).

    Up to where $|R(\lambda h)|$ is above $e^{0.1 h}$, or above that times $|e^{\lambda h}|$
    for a mode that grows by itself, with $R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24$ for "rk4" and
    $1 + z$ for "euler". For an undamped mode of frequency $\omega$ that is about
    $2.8 / \omega$, and $0.2 / \omega^2$: Euler's rule makes it grow at any step.

    Source: E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 1996, section
    IV.2 (stability functions of explicit rules).
    """
    fastest = np.abs(modes).max(initial=0.0)
    if not fastest > 1e-9:
        return np.inf
    steps = np.geomspace(1e-4, 10.0, 20_000)[:, None] / fastest
    z = steps * modes[None]
    higher = 0 if rule == "euler" else z / 2 * (1 + z / 3 * (1 + z / 4))
    allowed = np.maximum(1, np.exp(z.real)) * np.exp(GROWTH * steps)
    bad = (np.abs(1 + z * (1 + higher)) > allowed).any(axis=1)
    return float(steps[np.argmax(bad), 0]) if bad.any() else np.inf
