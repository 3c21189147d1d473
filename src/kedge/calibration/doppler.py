"""A Doppler log against a reference trajectory: scale, misalignment, arm and clock."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, RotationSpline

from kedge.core.errors import DataError
from kedge.estimation.log import Truth

FEWEST = 30
"""Readings beside the reference, below which nothing is fitted."""
TYPICAL = 0.03  # m/s; larger residuals are weighed down
LONGEST = 5.0  # s, of a lag


class Calibration(NamedTuple):
    """What a Doppler log makes of the velocity, in the words of the sensor ``doppler``."""

    scale: float
    misalignment: Float[np.ndarray, "3"]  # rad
    arm: Float[np.ndarray, "3"]  # m, forward, left, up
    lag: float
    """s by which the log's stamps are early: a reading stamped t is of t + lag."""
    std: float
    """m/s, of what is left by component."""

    def overrides(self, sensor: str) -> dict[str, str]:
        """What a rig file would say of it, for ``--set``."""

        def listed(values: np.ndarray) -> str:
            return f"[{', '.join(f'{value:.6f}' for value in values)}]"

        return {
            f"sensors.{sensor}.latency": f"{-self.lag:.4f}",
            "prior.mean.doppler_scale": f"{self.scale:.6f}",
            "prior.mean.doppler_misalignment": listed(self.misalignment),
            "prior.mean.doppler_arm": listed(self.arm),
        }


def calibrate(
    time: Float[np.ndarray, " n"], velocity: Float[np.ndarray, "n 3"], reference: Truth
) -> Calibration:
    r"""Fit $z = s \exp(-\epsilon) (v_b + \omega \times l)$ at the time $t + \tau$.

    The reference's velocity and attitude are continued between its samples by splines, and its
    angular rate is that of the spline. Residuals count as by the loss soft L1. An arm can be
    told only where the vehicle turns, a lag only where its velocity changes.

    Args:
        time: stamps of the readings, in s, on the reference's clock.
        velocity: forward, left, up.
        reference: with ``attitude`` and ``velocity_body``.

    Raises:
        DataError: too few readings lie beside the reference, or it lacks a field.

    Source: J. Kinsey and L. Whitcomb, "In situ alignment calibration of attitude and Doppler
    sensors for precision underwater vehicle navigation: theory and experiment", IEEE Journal of
    Oceanic Engineering 32(2), 2007 (least squares against a reference).
    """
    for field in ("attitude", "velocity_body"):
        if field not in reference.fields:
            raise DataError(f"calibrate: the reference has no {field}; a Doppler log needs it")
    begin, end = reference.time[0] + LONGEST, reference.time[-1] - LONGEST
    usable = (time >= begin) & (time <= end) & np.isfinite(velocity).all(axis=1)
    if usable.sum() < FEWEST:
        raise DataError(
            f"calibrate: found {usable.sum()} readings beside the reference, from {begin:.1f} "
            f"to {end:.1f} s; expected {FEWEST} or more"
        )
    time, velocity = time[usable], velocity[usable]
    turns = Rotation.from_quat(reference.fields["attitude"][:, [1, 2, 3, 0]])
    attitude = RotationSpline(reference.time, turns)
    in_map = CubicSpline(reference.time, turns.apply(reference.fields["velocity_body"]))

    def residuals(x: np.ndarray) -> np.ndarray:
        when = time + x[7]
        body = attitude(when).inv().apply(in_map(when))
        swung = body + np.cross(attitude(when, 1), x[4:7])
        return (x[0] * Rotation.from_rotvec(-x[1:4]).apply(swung) - velocity).ravel()

    high = np.array([2.0, *[np.pi / 4] * 3, *[30.0] * 3, LONGEST])
    low = np.array([0.5, *-high[1:]])
    first = np.array([1.0, *[0.0] * 7])
    solution = least_squares(
        residuals, first, bounds=(low, high), loss="soft_l1", f_scale=TYPICAL
    )
    x, misfit = solution.x, residuals(solution.x)
    return Calibration(
        float(x[0]), x[1:4], x[4:7], float(x[7]), float(np.sqrt(np.mean(misfit**2)))
    )


def typical(calibrations: list[Calibration]) -> Calibration:
    """The median of several, number by number."""
    columns = [np.median(column, axis=0) for column in zip(*calibrations, strict=True)]
    scale, misalignment, arm, lag, std = columns
    return Calibration(float(scale), misalignment, arm, float(lag), float(std))
