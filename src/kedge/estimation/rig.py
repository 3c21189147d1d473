"""Rigs: a vehicle, the sensors installed on it, and what is believed at the start."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter, AbstractSensor, AbstractVehicle, Ranging
from kedge.core.errors import ContractError
from kedge.core.manifolds import Chart, charts_of
from kedge.estimation.correlated_error import CorrelatedError as CorrelatedError
from kedge.estimation.mount import Mount as Mount
from kedge.estimation.mount import seen_from, validation_error
from kedge.estimation.rig_checks import check_noise, check_prior
from kedge.filters.wrappers.gated import Gated
from kedge.filters.wrappers.robust import Robust
from kedge.filters.wrappers.wrapper import RECOVERY
from kedge.numerics.losses import Loss


class Installation(eqx.Module):
    """A sensor on a vehicle. Its name, not its class, is its identity."""

    name: str = eqx.field(static=True)
    sensor: AbstractSensor
    rate: float | None = eqx.field(static=True, default=None)
    """Hz, for simulation; the sensor's nominal rate if not given."""
    latency: float = eqx.field(static=True, default=0.0)
    """s from the event to its stamp; logs are built with event time = stamp - latency."""
    gate: float | None = eqx.field(static=True, default=None)
    """False-alarm probability of the sensor's gate; no gate if not given."""
    mount: Mount | None = None
    robust: Loss | None = None
    """How readings far from the prediction are weighed down; not at all if not given."""
    recovery: float | None = eqx.field(static=True, default=None)
    """s of nothing but outliers, by its gate or its robust loss, after which a reading is let
    in (:mod:`kedge.estimation.recovery`); :data:`RECOVERY` if not given, infinity is never."""
    allowed_silence: float | None = eqx.field(static=True, default=None)
    """s without a reading of it that is fused, after which the estimate counts as degraded."""
    all_targets: bool = eqx.field(static=True, default=False)
    """Whether, in simulation, it reads all targets of its map at once, not in turn."""
    true_sensor: AbstractSensor | None = None
    """What it is in simulation, where that is not what filters take it for."""
    error: CorrelatedError | None = None
    """What it errs by beside its white noise, with a memory; a rig carries it in its state by
    :func:`kedge.estimation.error_states.with_errors`."""

    def __check_init__(self):
        if self.all_targets and self.targets is None:
            raise ContractError(
                f"sensor {self.name!r}: all_targets is set, but it has no map of targets"
            )
        if self.recovery is not None and self.gate is None and self.robust is None:
            raise ContractError(
                f"sensor {self.name!r}: recovery is {self.recovery:g} s, but there is no gate "
                "or robust loss to recover from"
            )
        if not math.isfinite(self.latency):
            raise ContractError(f"sensor {self.name!r}: latency is {self.latency}, not finite")

    def judged(self, filter: AbstractFilter) -> AbstractFilter:
        """The filter with the sensor's robust loss and its gate around it.

        A filter that weighs by itself takes a gate without a loss for a Student-t.
        """
        loss = Loss() if self.robust is None and self.gate is not None else self.robust
        if (weighing := filter.weighing(loss)) is not None:
            return weighing
        recovery = RECOVERY if self.recovery is None else self.recovery
        if self.robust is not None:
            loss = self.robust
            filter = Robust(filter, loss.kind, loss.tuning, loss.side, recovery=recovery)
        return filter if self.gate is None else Gated(filter, self.gate, recovery=recovery)

    def expect(self, state: Any, target: Int[Array, ""]) -> Any:
        """The measurement of one target without white noise: with the errors in the state."""
        expected = self.sensor.for_target(target).expect(self._moved(state))
        if self.error is None:
            return expected
        return self.error.added(expected, state, target, self.name, self.targets)

    def noise_cov(self, state: Any, target: Int[Array, ""]) -> Float[Array, "m m"]:
        """The sensor's own noise for one target."""
        return self.sensor.for_target(target).noise_cov(self._moved(state))

    def noise_variance(self, state: Any, target: Int[Array, ""]) -> Float[Array, " m"] | None:
        """Its diagonal where the components are independent by construction, else None."""
        return self.sensor.for_target(target).noise_variance(self._moved(state))

    def ranging(self, state: Any, target: Int[Array, ""]) -> Ranging | None:
        """The anchors of a sensor of ranges, moved so that they say where the vehicle is."""
        at_mount = self._moved(state)
        sensor = self.sensor.for_target(target)
        ranging = sensor.ranging(sensor.project(at_mount))
        if ranging is not None and self.error is not None:
            expected = sensor.expect(at_mount)
            errors = self.error.of_target(expected, state, target, self.name, self.targets)
            if errors is not None:
                ranging = ranging._replace(bias=ranging.bias + errors)
        if ranging is None or self.mount is None:
            return ranging
        return ranging._replace(
            anchors=ranging.anchors - (at_mount.position - state.position)[None]
        )

    @property
    def targets(self) -> int | None:
        """How many targets are on the sensor's map; None if it has no map."""
        leaves = jax.tree.leaves(getattr(self.sensor, "target", None))
        return leaves[0].shape[0] if leaves else None

    def knows(self, target: Int[Array, ""]) -> Bool[Array, ""]:
        """Whether a target is on the sensor's map; without a map: whether it is one."""
        known = target >= 0
        return known if self.targets is None else known & (target < self.targets)

    def _moved(self, state: Any) -> Any:
        """The state as if the vehicle stood where the sensor sits."""
        return state if self.mount is None else seen_from(self.mount, state)


class Origin:
    """The file that a rig was read from. All are equal: none compiles anew."""

    def __init__(self, config: Any = None):
        self.config = config

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin)

    def __hash__(self) -> int:
        return 0

    def __repr__(self) -> str:
        return "Origin()"


class Rig(eqx.Module):
    """One description of a vehicle and its sensors, for studies, logs and live runs.

    Raises:
        ContractError: a sensor reads a field that the vehicle's state has not, two sensors
            share a name, the prior does not fit the state or is no belief, noise is no noise.
    """

    vehicle: AbstractVehicle
    sensors: tuple[Installation, ...] = eqx.field(converter=tuple)
    prior: Gaussian
    origin: Origin = eqx.field(static=True, default=Origin(), repr=False)
    """For :func:`kedge.read_log`: where the columns of a log are said."""

    def __check_init__(self):
        names = [sensor.name for sensor in self.sensors]
        for name in names:
            if names.count(name) > 1:
                raise ContractError(f"two sensors are called {name!r}; names must differ")
        state = type(self.vehicle.start())
        for installation in self.sensors:
            check_reads(installation, state, type(self.vehicle).__name__)
        check_prior(self.prior, self.vehicle)
        check_noise(self.sensors, self.vehicle, self.prior.mean)

    @property
    def names(self) -> tuple[str, ...]:
        """The sensors' names."""
        return tuple(sensor.name for sensor in self.sensors)

    def index(self, name: str) -> int:
        """Position of a sensor by name.

        Raises:
            ContractError: there is none of that name.
        """
        names = [sensor.name for sensor in self.sensors]
        if name not in names:
            raise ContractError(f"no sensor {name!r} on this rig; there are {names}")
        return names.index(name)


def check_reads(installation: Installation, state: Any, vehicle: str) -> None:
    """Refuse a sensor on a vehicle whose state lacks what it reads.

    Raises:
        ContractError: a required field is missing, or a field has another chart.
    """
    sensor = installation.sensor
    has, optional = charts_of(state), sensor.reads._field_defaults
    needs: dict[str, Chart] = charts_of(sensor.reads)
    wrong = {
        name: chart
        for name, chart in needs.items()
        if has.get(name, chart if name in optional else None) != chart
    }
    if wrong:
        raise ContractError(
            f"{type(sensor).__name__} ({installation.name!r}) reads {wrong}, but the state of "
            f"{vehicle} is {has}"
        )
    if installation.mount is not None:
        why = validation_error(installation.mount, has, set(needs))
        if why is not None:
            raise ContractError(f"sensor {installation.name!r} {why.format(vehicle=vehicle)}")


def check_step(vehicle: AbstractVehicle, dt: float, what: str) -> None:
    """Refuse a step that is too long for a vehicle to stay stable.

    Raises:
        ContractError: naming the limit.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(vehicle)):
        return  # within a trace, where it was checked before
    limit = vehicle.longest_step()
    if dt > limit:
        raise ContractError(
            f"{what} is {dt:g} s, expected at most {limit:.3g} s: beyond that the step of "
            f"{type(vehicle).__name__} is not stable"
        )


def as_arrays(tree: Any) -> Any:
    """Turn float parameters into arrays, so that changing one recompiles nothing."""

    def convert(leaf: Any) -> jax.Array:
        return jnp.asarray(leaf, float if isinstance(leaf, float) else jnp.result_type(leaf))

    return jax.tree.map(convert, tree)
