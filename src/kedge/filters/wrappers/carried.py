"""A filter of some fields of the state; the others are integrated from what it estimates."""

import functools as ft
from collections.abc import Sequence
from typing import Any, NamedTuple, get_type_hints

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import space, space_of
from kedge.core.quantities import Scalar
from kedge.core.registry import unknown
from kedge.filters.wrappers.wrapper import AbstractWrapper


class CarriedBelief(eqx.Module):
    """The inner filter's belief, and the fields that are carried along."""

    inner: Any
    rest: dict[str, Any]
    cls: Any = eqx.field(static=True)
    """The class of the whole state."""

    def moments(self) -> Gaussian:
        """Mean and covariance of the whole state: none of what is carried."""
        mean, cov = self.inner.moments()
        places = _places(self.cls, tuple(self.rest))
        whole = jnp.zeros((space_of(self.cls).size,) * 2, cov.dtype)
        whole = whole.at[np.ix_(places, places)].set(cov)
        return Gaussian(_joined(self.cls, mean, self.rest), whole)

    def inflated(self, factor: Scalar) -> "CarriedBelief":
        """The inner belief widened."""
        return CarriedBelief(self.inner.inflated(factor), self.rest, self.cls)


class Carried(AbstractWrapper):
    r"""Estimates the state without ``fields``; those follow by the vehicle's step at the mean.

    $x_c^- = f_c(\hat x, x_c, u)$. They have no covariance, and no reading corrects them: so
    positions that papers integrate from estimated velocities, after the filter and outside it.
    Vehicle and sensors see the whole state, the inner filter sees the rest of it only.

    Raises:
        ContractError: when first run, if the state has no such field or nothing else.

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter,
    ensemble Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories",
    2022, section 3.1 (velocities are estimated, then transformed to positions).
    """

    fields: tuple[str, ...] = eqx.field(static=True, default=())

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> CarriedBelief:
        """The prior of what is estimated, and the mean of what is not."""
        cls = type(prior.mean)
        for name in self.fields:
            if name not in cls._fields:
                known = list(cls._fields)
                raise ContractError(f"carried: {unknown('field of the state', name, known)}")
        if set(self.fields) == set(cls._fields):
            raise ContractError(f"carried: found {list(self.fields)}, which is the whole state")
        places = _places(cls, self.fields)
        part = Gaussian(_part(prior.mean, self.fields), prior.cov[np.ix_(places, places)])
        rest = {name: jnp.asarray(getattr(prior.mean, name)) for name in self.fields}
        return CarriedBelief(self.inner.init(part, key), rest, cls)

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> CarriedBelief:
        """Both: the rest from the mean before the step."""
        noises = space(vehicle.noise_density())
        calm = noises.unflatten(noises.zeros())
        whole = _joined(belief.cls, belief.inner.moments().mean, belief.rest)
        after = vehicle.step(whole, control, calm, dt)
        part = _PartOfVehicle(vehicle, belief.rest, belief.cls)
        inner = self.inner.predict(part, belief.inner, control, dt, key)
        rest = {name: jnp.asarray(getattr(after, name)) for name in belief.rest}
        return CarriedBelief(inner, rest, belief.cls)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[CarriedBelief, Innovation]:
        """The inner filter's."""
        part = _PartOfModel(model, belief.rest, belief.cls)
        inner, score = self.inner.update(part, belief.inner, measurement, key)
        return CarriedBelief(inner, belief.rest, belief.cls), score

    def unwrap(self, belief: Any) -> Any:
        """The inner belief."""
        return belief.inner

    def reset(self, belief: CarriedBelief, factor: Scalar) -> CarriedBelief:
        """The inner filter's; what is carried along stays."""
        return CarriedBelief(self.inner.reset(belief.inner, factor), belief.rest, belief.cls)


def carrying(inner: AbstractFilter, fields: Sequence[str]) -> AbstractFilter:
    """The filter itself if nothing is carried."""
    return Carried(inner, tuple(fields)) if fields else inner


class _PartOfVehicle(AbstractVehicle[Any, Any, Any]):
    """The vehicle's motion of what is estimated, the rest held."""

    vehicle: AbstractVehicle
    rest: dict[str, Any]
    cls: Any = eqx.field(static=True)

    def step(self, state: Any, control: Any, noise: Any, dt: Scalar) -> Any:
        whole = _joined(self.cls, state, self.rest)
        return _part(self.vehicle.step(whole, control, noise, dt), tuple(self.rest))

    def noise_density(self) -> Any:
        return self.vehicle.noise_density()

    def start(self) -> Any:
        return _part(self.vehicle.start(), tuple(self.rest))

    def nominal_control(self, time: Scalar) -> Any:
        return self.vehicle.nominal_control(time)


class _PartOfModel(AbstractMeasurementModel[Any]):
    """A measurement model as a function of what is estimated."""

    model: AbstractMeasurementModel
    rest: dict[str, Any]
    cls: Any = eqx.field(static=True)

    def expect(self, state: Any) -> Any:
        return self.model.expect(_joined(self.cls, state, self.rest))

    def noise_cov(self, state: Any) -> Float[Array, "m m"]:
        return self.model.noise_cov(_joined(self.cls, state, self.rest))

    def noise_variance(self, state: Any) -> Float[Array, " m"] | None:
        return self.model.noise_variance(_joined(self.cls, state, self.rest))

    def dof(self) -> Int[Array, ""] | int:
        return self.model.dof()

    def source(self) -> str:
        return self.model.source()


@ft.cache
def _part_class(cls: Any, without: frozenset[str]) -> Any:
    hints = get_type_hints(cls, include_extras=True)
    kept = [(name, hint) for name, hint in hints.items() if name not in without]
    create: Any = NamedTuple  # a type checker wants the fields written out
    return create(f"PartOf{cls.__name__}", kept)


def _part(state: Any, without: Sequence[str]) -> Any:
    cls = _part_class(type(state), frozenset(without))
    return cls(*(getattr(state, name) for name in cls._fields))


def _joined(cls: Any, part: Any, rest: dict[str, Any]) -> Any:
    return cls(**part._asdict(), **rest)


def _places(cls: Any, without: Sequence[str]) -> Int[np.ndarray, " k"]:
    """Where in a tangent vector of the whole state the estimated components stand."""
    slices = space_of(cls).slices()
    kept = [
        np.arange(cut.start, cut.stop) for name, cut in slices.items() if name not in without
    ]
    return np.concatenate(kept)
