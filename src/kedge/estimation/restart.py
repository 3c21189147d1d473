"""A belief that is given to an estimator in mid-drive: an operator's pose, another filter's."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kedge.core.beliefs import Gaussian
from kedge.core.errors import DataError
from kedge.core.manifolds import space
from kedge.estimation.admission import numbers


class Jump(NamedTuple):
    """How far an estimate went at a reset."""

    time: Any
    """As the estimator's clock counts."""
    labels: tuple[str, ...]
    delta: Float[np.ndarray, " n"]
    """New less old mean, in the tangent space at the old."""


def restarted(before: Gaussian, mean: Any, cov: Any = None) -> Gaussian:
    """The belief with another mean and covariance, whole or in part.

    ``mean`` is a state, or the values of some of its fields by name; ``cov`` is a matrix, or
    standard deviations of some fields by name. Fields without a value keep theirs; those with a
    deviation are no longer correlated with others.

    Raises:
        DataError: a field is unknown, a value no number or of another shape, a deviation not
            above 0, or the matrix no covariance.
    """
    states = space(before.mean)
    fields = states.cls._fields
    if not isinstance(mean, Mapping):
        if type(mean) is not states.cls:
            raise DataError(
                f"reset: found {type(mean).__name__}, expected a state of the vehicle, or "
                f"values by name, of {', '.join(fields)}"
            )
        mean = dict(zip(fields, mean, strict=True))
    given: Mapping[str, Any] = mean
    values = {
        name: _checked(f"reset: {name}", value, np.shape(_field(before.mean, name, fields)))
        for name, value in given.items()
    }
    placed = before.mean._replace(**{name: jnp.asarray(v) for name, v in values.items()})
    placed = states.boxplus(placed, states.zeros())  # an angle lies in its circle
    if not isinstance(cov, Mapping):
        return Gaussian(placed, before.cov if cov is None else _covariance(cov, states.size))
    matrix, cuts = np.array(before.cov), states.slices()
    deviations: Mapping[str, Any] = cov
    for name, value in deviations.items():
        _field(before.mean, name, fields)
        cut = cuts[name]
        std = np.ravel(np.asarray(value, float))
        if (
            len(std) not in (1, cut.stop - cut.start)
            or not (np.isfinite(std) & (std > 0)).all()
        ):
            raise DataError(
                f"reset: std of {name}: found {value}, expected one number above 0, or "
                f"{cut.stop - cut.start}"
            )
        matrix[cut, :], matrix[:, cut] = 0.0, 0.0
        matrix[cut, cut] = np.diag(np.broadcast_to(std**2, (cut.stop - cut.start,)))
    return Gaussian(placed, jnp.asarray(matrix))


def jump(time: Any, before: Gaussian, after: Gaussian) -> Jump:
    """From one belief to the other."""
    states = space(before.mean)
    return Jump(time, states.labels, np.asarray(states.boxminus(after.mean, before.mean)))


def _field(state: Any, name: str, fields: tuple[str, ...]) -> Any:
    if name not in fields:
        raise DataError(f"reset: {name}: no such field, expected one of {', '.join(fields)}")
    return getattr(state, name)


def _checked(what: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = numbers(what, value, shape)
    if not np.isfinite(array).all():
        raise DataError(f"{what}: found {value}, expected finite numbers")
    return array


def _covariance(cov: Any, size: int) -> Any:
    matrix = _checked("reset: cov", cov, (size, size))
    symmetric = np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0)
    scale = np.sqrt(np.maximum(matrix.diagonal(), 1e-300))
    least = np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min() if symmetric else -1.0
    if least < -1e-9:
        raise DataError(
            "reset: cov: found a matrix that is not symmetric or has a negative eigenvalue, "
            "expected a covariance"
        )
    return jax.numpy.asarray((matrix + matrix.T) / 2)
