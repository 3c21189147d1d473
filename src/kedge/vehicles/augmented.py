"""Any vehicle with slowly varying quantities added to its state: biases, scales, currents.

An augmented state that has the name of a parameter of the vehicle takes that parameter's place
in ``step``; one that has the name of an optional field of a sensor is read by the sensor. So
no vehicle and no sensor needs a second version with its biases estimated.
"""

import dataclasses
import functools as ft
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple, get_type_hints

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import AUGMENTED, CONSIDERED, Chart, charts_of, space
from kedge.core.quantities import Scalar

SMALL = 1e-9
"""Steps by time constants below which a state is a random walk to rounding."""


class GaussMarkov(eqx.Module):
    r"""How an augmented state wanders: $\dot s = (s_0 - s) / \tau + w$.

    ``random_walk`` is the density q of w, in the state's unit per second per root hertz; with
    the default time constant the quantity is a random walk. A step is exact:
    $s' = s_0 + e^{-\Delta t / \tau} (s - s_0)$ and a variance of
    $q^2 \tau / 2\,(1 - e^{-2 \Delta t / \tau})$ more, so that a state which begins with the
    standard deviation $q \sqrt{\tau / 2}$ keeps it.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 8.4.
    """

    nominal: Scalar | Float[Array, " k"]
    random_walk: Scalar | Float[Array, " k"] = 0.0
    time_constant: Scalar | Float[Array, " k"] = float("inf")  # s

    def after(self, value: Any, time: Scalar) -> Any:
        """The state after some time without noise."""
        return self.nominal + (value - self.nominal) * jnp.exp(-time / self.time_constant)

    def kept(self, dt: Scalar) -> Any:
        """What a noise that is held over a step leaves at its end, by what it brought."""
        decay = 2 * dt / jnp.asarray(self.time_constant)
        small = decay < SMALL
        decay = jnp.where(small, 1.0, decay)
        return jnp.where(small, 1.0, jnp.sqrt(-jnp.expm1(-decay) / decay))


class Augmented(AbstractVehicle[Any, Any, Any]):
    """A vehicle and its augmented states.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 11.2 (state augmentation).
    """

    vehicle: AbstractVehicle
    augmented: dict[str, GaussMarkov]
    charts: tuple[tuple[str, Chart], ...] = eqx.field(static=True)
    considered: tuple[str, ...] = eqx.field(static=True, default=())
    """Those that no reading corrects, while their spread counts in every update."""

    def step(self, state: Any, control: Any, noise: Any, dt: Scalar) -> Any:
        """Step the vehicle with the values at the middle of the step, and let them wander."""
        vehicle = self.vehicle
        for name, _ in self.charts:
            if hasattr(vehicle, name):
                value = self.augmented[name].after(getattr(state, name), dt / 2)
                vehicle = eqx.tree_at(lambda v, n=name: getattr(v, n), vehicle, value)
        inner, noises = type(vehicle.start()), type(vehicle.noise_density())
        stepped = vehicle.step(
            inner(*state[: len(inner._fields)]),
            control,
            noises(*noise[: len(noises._fields)]),
            dt,
        )
        after = []
        for name, _ in self.charts:
            process = self.augmented[name]
            shock = getattr(noise, name) * dt * process.kept(dt)
            after.append(process.after(getattr(state, name), dt) + shock)
        return type(state)(*stepped, *after)

    def noise_density(self) -> Any:
        """The vehicle's, then the walks."""
        inner = self.vehicle.noise_density()
        random_walks = (
            jnp.broadcast_to(jnp.asarray(self.augmented[name].random_walk, float), c.shape)
            for name, c in self.charts
        )
        return _widened(type(inner), self.charts, ())(*inner, *random_walks)

    def start(self) -> Any:
        """The vehicle's, then the nominal values."""
        inner = self.vehicle.start()
        nominal = (
            jnp.broadcast_to(jnp.asarray(self.augmented[name].nominal, float), c.shape)
            for name, c in self.charts
        )
        return _widened(type(inner), self.charts, self.considered)(*inner, *nominal)

    def nominal_control(self, time: Scalar) -> Any:
        """The vehicle's."""
        return self.vehicle.nominal_control(time)

    def longest_step(self) -> float:
        """The vehicle's."""
        return self.vehicle.longest_step()

    def control_limits(self) -> Any:
        """The vehicle's."""
        return self.vehicle.control_limits()


class Drift(NamedTuple):
    """What a rig says of an augmented state."""

    random_walk: float = 0.0
    time_constant: float = float("inf")


def augment(
    vehicle: AbstractVehicle, augmented: Mapping[str, Drift], sensors: Sequence[AbstractSensor]
) -> AbstractVehicle:
    """Add augmented states to a vehicle's state; their nominal values and charts are found.

    Raises:
        ContractError: a name is neither a parameter of the vehicle nor an optional field of a
            sensor, or is in the state already.
    """
    if not augmented:
        return vehicle
    known = _candidates(vehicle, sensors)
    taken = space(vehicle.start()).cls._fields
    processes, charts = {}, []
    for name, wander in augmented.items():
        if name in taken:
            raise ContractError(f"augmented state {name!r} is in the vehicle's state already")
        if name not in known:
            if name in {field.name for field in dataclasses.fields(vehicle)}:
                raise ContractError(
                    f"augmented state {name!r} is a parameter of {type(vehicle).__name__} "
                    "whose annotation has no unit; annotate it with a quantity from "
                    "kedge.core.quantities, such as Metres or Ratio, and it can be estimated"
                )
            raise ContractError(
                f"augmented state {name!r} is neither a parameter of the vehicle nor an "
                f"optional field of a sensor; there are {', '.join(sorted(known)) or 'none'}"
            )
        chart, nominal = known[name]
        processes[name] = GaussMarkov(
            1.0 * jnp.asarray(nominal), wander.random_walk, wander.time_constant
        )
        charts.append((name, chart))
    return Augmented(vehicle, processes, tuple(charts))


def carrying(
    vehicle: AbstractVehicle,
    processes: Mapping[str, tuple[Chart, GaussMarkov]],
    considered: Sequence[str] = (),
) -> AbstractVehicle:
    """A vehicle with further states of any name in its state, which sensors' errors are.

    Raises:
        ContractError: a name is in the state already.
    """
    if not processes:
        return vehicle
    fields = space(vehicle.start()).cls._fields
    if taken := [name for name in processes if name in fields]:
        raise ContractError(f"augmented state {taken[0]!r} is in the vehicle's state already")
    if not isinstance(vehicle, Augmented):
        vehicle = Augmented(vehicle, {}, ())
    return Augmented(
        vehicle.vehicle,
        vehicle.augmented | {name: process for name, (_, process) in processes.items()},
        vehicle.charts + tuple((name, chart) for name, (chart, _) in processes.items()),
        vehicle.considered + tuple(considered),
    )


def sharing_augmented(vehicle: AbstractVehicle, other: AbstractVehicle) -> AbstractVehicle:
    """A vehicle with the augmented states of another, whether it heeds them or not."""
    if not isinstance(other, Augmented):
        return vehicle
    return Augmented(vehicle, other.augmented, other.charts, other.considered)


def _candidates(
    vehicle: AbstractVehicle, sensors: Sequence[AbstractSensor]
) -> dict[str, tuple[Chart, Any]]:
    parameters = {f.name for f in dataclasses.fields(vehicle) if not f.metadata.get("static")}
    candidates = {
        name: (chart, getattr(vehicle, name))
        for name, chart in _charts_of_parameters(type(vehicle)).items()
        if name in parameters
    }
    for sensor in sensors:
        charts = charts_of(sensor.reads)
        for name, default in sensor.reads._field_defaults.items():
            candidates.setdefault(name, (charts[name], default))
    return candidates


def _charts_of_parameters(cls: type) -> dict[str, Chart]:
    hints = get_type_hints(cls, include_extras=True)
    return {
        name: meta
        for name, hint in hints.items()
        for meta in getattr(hint, "__metadata__", ())
        if hasattr(meta, "boxplus")
    }


@ft.cache
def _widened(
    cls: Any, extra: tuple[tuple[str, Chart], ...], considered: tuple[str, ...]
) -> Any:
    """The ``NamedTuple`` class of ``cls`` with fields added; one class for equal arguments."""
    fields = list(get_type_hints(cls, include_extras=True).items())
    for name, chart in extra:
        marks = (AUGMENTED, CONSIDERED) if name in considered else (AUGMENTED,)
        fields.append((name, Annotated[(Any, chart, *marks)]))
    create: Any = NamedTuple  # a type checker wants the fields written out
    return create(f"Augmented{cls.__name__}", fields)
