"""Scenarios: a rig in a world, for so long, in such steps."""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray

from kedge.core.contracts import AbstractFilter, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.core.quantities import Scalar
from kedge.core.registry import unknown
from kedge.estimation.log import SECOND
from kedge.estimation.rig import Installation, Rig, check_step
from kedge.simulation.faults import (
    CONTROL,
    AbstractDeliveryFault,
    AbstractReadingFault,
    DrawnFault,
    Fault,
    drawn,
    validation_error,
)
from kedge.vehicles.augmented import Augmented

FEEDBACKS = ("none", "truth", "readings", "filter")


class History(NamedTuple):
    """What really happened, and what was told of it."""

    path: Any
    """The true state at the end of every step, with the fields that the sensors read; leading
    axis K."""
    controls: Any
    """What filters are told of the control of every step; leading axis K."""
    start: Any
    """The true state at time 0."""


class AbstractWorld(eqx.Module):
    """What really moves, where a scenario's truth is not the rig's own vehicle.

    The true vehicle may be another one than the filters', be guided along a route, slip, and
    be told of by encoders that miss counts. Its state needs the fields of the rig's state that
    are estimated and scored, and those that sensors read.
    """

    guided: ClassVar[bool] = False
    """Whether it is steered by what is believed of it."""
    drives: ClassVar[bool] = False
    """Whether what moves is the scenario's vehicle, as it is at each time."""
    watches: ClassVar[tuple[str, ...]] = ()
    """What studies report of the truth itself, such as its distance from a route."""

    def watch(self, scenario: "Scenario", history: History) -> Float[Array, "K w"]:
        """What ``watches`` names, at every step; studies report its root mean square.

        The path is given with the fields of the rig's state.
        """
        del history
        return jnp.zeros((scenario.steps, 0))

    @abc.abstractmethod
    def unfold(
        self, scenario: "Scenario", key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        """One run, traced; ``sensing`` are the keys of all readings, by sensor.

        A world whose guidance hears its sensors draws their noise from these keys by
        :func:`kedge.simulation.sensing.sensed`, and so hears what filters will.
        """


class LoopFilter(eqx.Module):
    """The filter that a guidance believes."""

    filter: AbstractFilter
    name: str = eqx.field(static=True, default="")
    """Whose draws it makes; a study's filter of that name makes the same."""
    key: PRNGKeyArray | None = None
    error: Float[Array, " n"] | None = None
    """Of its first mean against the truth, in units of the prior's roots; if None, it starts
    from the prior's own mean."""


class Scenario(eqx.Module):
    """A rig driven by its vehicle's ``nominal_control``, or in a world; sensors have rates.

    A sensor over a map sees its targets in turn, one each time it fires, or all of them each
    time if it is installed for ``all_targets``. Without a world the truth is drawn from the
    rig's prior ``spin_up`` seconds before time 0 and moves until then, so that it begins on the
    attractor of a system that has one.

    The guidance of a world that has one steers by ``feedback``: "none" (it believes that all
    goes as intended), "truth", "readings" (each as it is, until the next) or "filter": its
    ``loop_filter``, or each filter of a study, which then is judged in a loop of its own.

    ``faults`` change readings in their order, and what filters are told of the control.
    """

    rig: Rig
    duration: float = eqx.field(static=True, default=60.0)  # s
    dt: float = eqx.field(static=True, default=0.1)  # s, the step of the truth
    spin_up: float = eqx.field(static=True, default=0.0)  # s
    world: AbstractWorld | None = None
    feedback: str = eqx.field(static=True, default="none")
    loop_filter: LoopFilter | None = None
    faults: tuple[Fault, ...] = ()
    true_vehicle: AbstractVehicle | None = None
    """What really moves, without augmented states, if not the rig's vehicle."""
    true_from: float = eqx.field(static=True, default=0.0)  # s, until when the rig's does
    fault_key: PRNGKeyArray | None = None
    """From which they are drawn; :func:`kedge.simulation.simulate.simulate` gives a run's."""

    def __check_init__(self):
        if not (self.dt > 0 and self.duration >= self.dt):
            raise ContractError(
                f"scenario: duration {self.duration:g} s and dt {self.dt:g} s; expected "
                "0 < dt <= duration"
            )
        check_step(self.rig.vehicle, self.dt, "scenario: dt")
        if self.true_vehicle is not None:
            check_step(self.true_vehicle, self.dt, "scenario: dt")
            if self.world is not None and not self.world.drives:
                raise ContractError(
                    "vehicle.true_parameters: the world moves a vehicle of its own; expected "
                    "none, or a world that drives the scenario's vehicle, such as lane-keeping"
                )
        if not 0 <= self.spin_up < np.inf:
            raise ContractError(f"scenario: spin_up is {self.spin_up:g} s, expected 0 or more")
        if self.world is not None and self.spin_up:
            raise ContractError(
                f"scenario: spin_up is {self.spin_up:g} s, expected 0: a world of its own "
                "begins at time 0"
            )
        if self.feedback not in FEEDBACKS:
            what = unknown("feedback", self.feedback, list(FEEDBACKS))
            raise ContractError(f"scenario: {what}")
        if self.feedback != "none" and not (self.world is not None and self.world.guided):
            raise ContractError(
                f'scenario: feedback is "{self.feedback}", but nothing is steered here; '
                'expected "none", or a world with a guidance'
            )
        if self.feedback in ("readings", "filter"):
            for installation in self.rig.sensors:
                if installation.all_targets:
                    raise ContractError(
                        f"sensors.{installation.name}: found all_targets, but a guidance that "
                        f'hears readings or a filter (feedback is "{self.feedback}") takes one '
                        "reading of a sensor at a time"
                    )
                if installation.error is not None:
                    raise ContractError(
                        f"sensors.{installation.name}: found an error with a memory, but a "
                        f"guidance that hears readings or a filter (feedback is "
                        f'"{self.feedback}") draws each by itself; expected feedback = "none" '
                        'or "truth"'
                    )
        if self.faults:
            self._check_faults()

    def _check_faults(self) -> None:
        spaces = {CONTROL: space_of(type(self.rig.vehicle.nominal_control(0.0)))}
        spaces |= {
            installation.name: space_of(installation.sensor.measures)
            for installation in self.rig.sensors
        }
        names = [fault.name for fault in self.faults]
        for fault in self.faults:
            if wrong := validation_error(fault, spaces):
                raise ContractError(f"faults.{fault.name}.{wrong}")
            if names.count(fault.name) > 1:
                raise ContractError(f"two faults are called {fault.name!r}; names must differ")
            by_itself = isinstance(fault.kind, AbstractReadingFault | AbstractDeliveryFault)
            if self.feedback in ("readings", "filter") and not (
                by_itself and fault.on != CONTROL
            ):
                raise ContractError(
                    f"faults.{fault.name}: a guidance that hears readings or a filter "
                    f'(feedback is "{self.feedback}") keeps no earlier readings, and knows its '
                    "controls; expected a fault that changes each reading by itself, or "
                    'feedback = "none" or "truth"'
                )

    @property
    def steps(self) -> int:
        """How many steps the truth takes."""
        return round(self.duration / self.dt)

    @property
    def each_in_its_loop(self) -> bool:
        """Whether a guidance is to believe each filter of a study in turn."""
        return self.feedback == "filter" and self.loop_filter is None

    def vehicle_at(self, time: Scalar) -> AbstractVehicle:
        """What really moves then: the rig's vehicle without augmented states, or another."""
        known, true = self.rig.vehicle, self.true_vehicle
        known = known.vehicle if isinstance(known, Augmented) else known
        if true is None or self.true_from == 0:
            return true or known
        return jax.tree.map(lambda a, b: jnp.where(time < self.true_from, a, b), known, true)

    def ticks(self, installation: Installation) -> np.ndarray:
        """The steps, counted from 1, at whose ends a sensor reads; as often as it reads."""
        rate = installation.rate or installation.sensor.nominal_rate
        every = max(1, round(1 / (rate * self.dt)))
        at_once = (installation.targets or 1) if installation.all_targets else 1
        return np.repeat(np.arange(every, self.steps + 1, every), at_once)

    def times(self, installation: Installation) -> np.ndarray:
        """The stamps of a sensor's readings, in s."""
        return np.round(self.ticks(installation) * self.dt * SECOND) / SECOND

    def drawn_faults(self, installation: Installation | None) -> tuple[DrawnFault, ...]:
        """The faults of a sensor (None: of what is told of the control), drawn for a run."""
        if installation is None:
            time = np.round(np.arange(self.steps) * self.dt * SECOND) / SECOND
            size, on = space_of(type(self.rig.vehicle.nominal_control(0.0))).size, CONTROL
            targets = 1
        else:
            time, on = self.times(installation), installation.name
            size, targets = installation.sensor.dof(), installation.targets or 1
        target = np.arange(len(time)) % targets
        return drawn(self.faults, on, time, target, size, self.fault_key)
