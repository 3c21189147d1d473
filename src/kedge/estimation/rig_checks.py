"""What a rig refuses: a prior that is no belief, noise that is no noise."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax.core import Tracer

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import charts_of, space_of

if TYPE_CHECKING:
    from kedge.estimation.rig import Installation

ROUNDING = 1e-6
"""Of a covariance, against its largest entry: what single precision leaves."""
UNIT = 0.01
"""By how much the length of a quaternion may differ from 1."""


def check_prior(prior: Gaussian, vehicle: AbstractVehicle) -> None:
    """Refuse a prior that does not fit the vehicle's state or is no belief.

    Raises:
        ContractError: mean or covariance of another type or shape, not finite, a quaternion
            that is no rotation, a covariance that is not symmetric or not positive
            semi-definite.
    """
    state, name = type(vehicle.start()), type(vehicle).__name__
    if type(prior.mean) is not state:
        raise ContractError(
            f"the prior's mean is a {type(prior.mean).__qualname__}, but the state of "
            f"{name} is a {state.__qualname__}"
        )
    size = space_of(state).size
    if np.shape(prior.cov) != (size, size):
        raise ContractError(
            f"the prior's covariance has shape {np.shape(prior.cov)}, but the state "
            f"{space_of(state).labels} needs {(size, size)}"
        )
    if _traced(prior):
        return  # checked before, where it was a number
    for (field, chart), value in zip(charts_of(state).items(), prior.mean, strict=True):
        array = np.asarray(value)
        if array.shape != chart.shape:
            raise ContractError(
                f"the prior's {field} has shape {array.shape}, expected {chart.shape}"
            )
        if not np.isfinite(array).all():
            raise ContractError(f"the prior's {field} is {array.tolist()}, expected it finite")
        if chart.shape != chart.tangent_shape and abs(np.linalg.norm(array) - 1) > UNIT:
            raise ContractError(
                f"the prior's {field} is {array.tolist()}, of length "
                f"{np.linalg.norm(array):.3g}; expected a unit quaternion (w, x, y, z)"
            )
    cov = np.asarray(prior.cov)
    if not np.isfinite(cov).all():
        raise ContractError("the prior's covariance is not finite")
    slack = ROUNDING * np.abs(cov).max(initial=0.0)
    if np.abs(cov - cov.T).max(initial=0.0) > slack:
        raise ContractError("the prior's covariance is not symmetric")
    least = float(np.linalg.eigvalsh(cov).min(initial=0.0))
    if least < -slack:
        raise ContractError(
            f"the prior's covariance is none: it has the eigenvalue {least:.6g}, expected none "
            "below 0"
        )


def check_noise(sensors: "Sequence[Installation]", vehicle: AbstractVehicle, mean: Any) -> None:
    """Refuse noise that is no noise.

    Raises:
        ContractError: a standard deviation is not above 0, or a density is below 0 or NaN.
    """
    for installation in sensors:
        sensor = installation.sensor.for_target(0)
        std = sensor.noise_std(sensor.project(mean))
        if _traced(std):
            continue  # checked before, where it was a number
        for field, value in std._asdict().items():
            if not np.all(np.asarray(value) > 0):
                raise ContractError(
                    f"sensors.{installation.name}: the noise of {field} has the standard "
                    f"deviation {np.asarray(value).tolist()}, expected above 0"
                )
    density = vehicle.noise_density()
    if _traced(density):
        return
    for field, value in density._asdict().items():
        if not np.all(np.asarray(value) >= 0):
            raise ContractError(
                f"vehicle: the noise density of {field} is {np.asarray(value).tolist()}, "
                "expected 0 or more"
            )


def _traced(tree: Any) -> bool:
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))
