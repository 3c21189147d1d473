"""Whether a log fits its rig, as far as that shows without truth."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtri

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space_of
from kedge.estimation.rig import Rig
from kedge.vehicles.augmented import Augmented

FAR = 2.0
"""Times what a rig claims that the middle one of its readings may be off by."""
ASTRAY = 3.0
"""Standard deviations by which a quantity may end from where the rig believes it to be."""


def off_by(nis: Float[np.ndarray, " n"], dof: Int[np.ndarray, " n"]) -> float | None:
    r"""How far off readings are, in what was expected: $\sqrt{\mathrm{med}(\epsilon / m)}$.

    $\epsilon$ is NIS, $m$ the median of chi-square with its degrees of freedom. About 1 if the
    rig is right; outliers, of which a robust loss or a gate takes care, do not show in it.
    None where no reading was judged.
    """
    known = (dof > 0) & np.isfinite(nis)
    if not known.any():
        return None
    return float(np.sqrt(np.median(nis[known] / chdtri(dof[known], 0.5))))


def astray(rig: Rig, last: Gaussian, seconds: float) -> dict[str, float]:
    """The augmented states that end far from where the rig believes them, in its deviations.

    Of a state that wanders the deviation is that after the log's ``seconds``. An offset of an
    anchor or a scale that a log drives so far stands for an error of something else.
    """
    if not isinstance(rig.vehicle, Augmented):
        return {}
    states, spread = space_of(type(last.mean)), np.asarray(rig.prior.cov).diagonal()
    cuts, ends = states.slices(), {}
    for name, process in rig.vehicle.augmented.items():
        if name in rig.vehicle.considered:
            continue
        expected = process.after(getattr(rig.prior.mean, name), seconds)
        gap = np.ravel(np.asarray(getattr(last.mean, name)) - np.asarray(expected))
        decay = np.exp(-2 * seconds / np.asarray(process.time_constant, float))
        lasting = np.where(decay < 1, 1 - decay, 0.0)
        tau: Any = np.where(lasting > 0, np.asarray(process.time_constant, float), 0.0)
        walked = np.asarray(process.random_walk) ** 2
        grown = np.where(lasting > 0, walked * tau / 2 * lasting, walked * seconds)
        std = np.sqrt(spread[cuts[name]] * decay + grown)
        for label, off, one in zip(
            states.labels[cuts[name]], gap, np.broadcast_to(std, gap.shape), strict=True
        ):
            if one > 0 and abs(off) > ASTRAY * one:
                ends[label] = float(off / one)
    return ends
