"""What an obstacle does to a range, and how to tell from the signal that one is there."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from kedge.core.errors import DataError

Signal = Float[np.ndarray, " n"]


def attenuation(amplitudes: Any, delays: Any, direct: int = 0, exponent: float = 2.0) -> float:
    r"""How much weaker the direct path is than the strongest, path loss taken out, in dB.

    $A = 10 \log_{10} \frac{\max_i a_i^2 \tau_i^\eta}{a_{DP}^2 \tau_{DP}^\eta}$ over the paths i
    with amplitudes $a_i$ and delays $\tau_i$ (s); ``direct`` is the number of the direct one.

    Raises:
        DataError: an amplitude or delay is not above 0, or there is no such path.

    Source: J. Qiu, Y. Zhang, M. Tang, P. Ma, J. Ran, "Research on AGV positioning method
    combined with IMU and UWB", Archives of Transport 64(4), 2022, equation 7, read with L the
    number of paths.
    """
    strength, delay = np.asarray(amplitudes, float), np.asarray(delays, float)
    if strength.shape != delay.shape or not 0 <= direct < strength.size:
        raise DataError(
            f"attenuation: found {strength.size} amplitudes, {delay.size} delays and the path "
            f"{direct} as the direct one"
        )
    if not (np.all(strength > 0) and np.all(delay > 0)):
        raise DataError("attenuation: expected amplitudes and delays above 0")
    power = strength**2 * delay**exponent
    return float(10 * np.log10(power.max() / power[direct]))


def excess_path(
    attenuation_db: float, per_metre: float, permittivity: float
) -> tuple[float, float]:
    r"""Thickness of an obstacle and how much longer it makes a range, both in m.

    $w = A / \alpha$ for a material that takes $\alpha$ dB/m, $\Delta d = (\sqrt{\epsilon_r} -
    1) w$.

    Raises:
        DataError: a negative attenuation, or a material that there is not.

    Source: J. Qiu, Y. Zhang, M. Tang, P. Ma, J. Ran, "Research on AGV positioning method
    combined with IMU and UWB", Archives of Transport 64(4), 2022, equation 7.
    """
    if not (attenuation_db >= 0 and per_metre > 0 and permittivity >= 1):
        raise DataError(
            f"excess path: found {attenuation_db:g} dB, {per_metre:g} dB/m and a permittivity "
            f"of {permittivity:g}; expected 0 or more, above 0, and 1 or more"
        )
    thickness = attenuation_db / per_metre
    return thickness, (permittivity**0.5 - 1) * thickness


class Suspicion(NamedTuple):
    r"""The probability that a link is blocked, from one feature of its signal.

    $p = 1 / (1 + \exp(-(c_0 + c_1 \Delta)))$ with $\Delta$ the received power less that of the
    first path, in dB: small in line of sight.

    Source: S. Maranò, W. Gifford, H. Wymeersch, M. Win, "NLOS identification and mitigation for
    localization based on UWB experimental data", IEEE Journal on Selected Areas in
    Communications 28(7), 2010.
    """

    intercept: float
    slope: float  # 1/dB

    def probability(self, feature: Array) -> Array:
        """Of each link."""
        return 1 / (1 + jnp.exp(-(self.intercept + self.slope * feature)))

    def std(self, feature: Array, clear: float, blocked: float) -> Array:
        """What to believe of the range: between its noise in line of sight and behind one."""
        share = self.probability(feature)
        return jnp.sqrt((1 - share) * clear**2 + share * blocked**2)


def fit_suspicion(feature: Any, blocked: Any, prior: float = 1e-3) -> Suspicion:
    """Logistic regression, with a weak pull of the slope to 0 that keeps it finite.

    Raises:
        DataError: links of one kind only, or features that are not finite.

    Source: C. Bishop, "Pattern Recognition and Machine Learning", 2006, section 4.3.3.
    """
    x, label = np.asarray(feature, float), np.asarray(blocked, float)
    if x.shape != label.shape or not np.isfinite(x).all() or len(np.unique(label)) != 2:
        raise DataError(
            "suspicion: expected finite features, and both links that are blocked and that are "
            "not"
        )
    rows, point = np.stack([np.ones_like(x), x], axis=1), np.zeros(2)
    pull = prior * np.diag([0.0, x.var()])
    for _ in range(50):
        share = 1 / (1 + np.exp(-np.clip(rows @ point, -500, 500)))
        slope = rows.T @ (label - share) - pull @ point
        bend = (rows * np.maximum(share * (1 - share), 1e-12)[:, None]).T @ rows + pull
        point = point + np.linalg.solve(bend, slope)
    return Suspicion(float(point[0]), float(point[1]))


def separation(feature: Any, blocked: Any) -> float:
    """Area under the curve of hits over false alarms: 0.5 for a feature that says nothing."""
    from scipy.stats import rankdata

    x, label = np.asarray(feature, float), np.asarray(blocked, bool)
    rank = rankdata(x)
    count = label.sum()
    return float((rank[label].sum() - count * (count + 1) / 2) / (count * (~label).sum()))


def link_states(
    error: Float[Array, "T m"],
    enter: float = 3.0,
    leave: float = 1.0,
    memory: float = 0.8,
) -> Bool[Array, "T m"]:
    r"""Whether each link is blocked, epoch by epoch, with hysteresis.

    The mean $s \leftarrow \rho s + (1 - \rho) e$ of the residuals e (measured less expected, in
    standard deviations) must rise above ``enter`` for a link to be blocked and fall below
    ``leave`` for it to be clear again; ``memory`` is $\rho$. Missing residuals (NaN) change
    nothing. Obstacles only lengthen ranges, so negative residuals never block a link.
    """

    def step(carry: tuple[Array, Array], one: Array) -> tuple[tuple[Array, Array], Array]:
        mean, state = carry
        mean = jnp.where(jnp.isnan(one), mean, memory * mean + (1 - memory) * one)
        state = jnp.where(state, mean > leave, mean > enter)
        return (mean, state), state

    start = jnp.zeros(error.shape[1]), jnp.zeros(error.shape[1], bool)
    return lax.scan(step, start, error)[1]
