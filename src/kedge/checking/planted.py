"""A good log with one thing wrong on purpose, to see what a check finds of it."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ConfigError
from kedge.core.quantities import Scalar
from kedge.core.registry import unknown
from kedge.estimation.correlated_error import CorrelatedError
from kedge.estimation.error_states import with_errors
from kedge.estimation.log import Recording
from kedge.estimation.mount import Mount
from kedge.estimation.rig import Installation, Rig
from kedge.sensors.gnss import Gnss
from kedge.sensors.ranges import Anchor, Ranges
from kedge.simulation.fault_kinds import Clock, Stuck
from kedge.simulation.faults import Fault
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.vehicles.unicycle import Control, State, Unicycle

DURATION = 120.0  # s
ANCHORS = np.array([[-12.0, -8.0], [14.0, -9.0], [12.0, 12.0], [-11.0, 10.0], [2.0, 15.0]])


class StopAndGo(AbstractVehicle[State, Control, Control]):
    """A unicycle that drives faster and slower, and turns to both sides."""

    vehicle: Unicycle

    def step(self, state: State, control: Control, noise: Control, dt: Scalar) -> State:
        return self.vehicle.step(state, control, noise, dt)

    def noise_density(self) -> Control:
        return self.vehicle.noise_density()

    def start(self) -> State:
        return self.vehicle.start()

    def nominal_control(self, time: Scalar) -> Control:
        speed = 1.0 + 0.8 * jnp.sin(0.35 * jnp.asarray(time))
        return Control(speed=speed, yaw_rate=0.1 + 0.4 * jnp.sin(0.22 * time))


def good() -> Rig:
    """A vehicle with odometry, a receiver of fixes and a radio, as they are said to be."""
    vehicle = StopAndGo(Unicycle(speed_noise=0.05, yaw_rate_noise=0.02))
    gnss = Installation("gnss", Gnss(std=0.1), rate=5.0)
    radio = Installation("radio", Ranges(target=Anchor(ANCHORS), range_std=0.1), rate=10.0)
    prior = Gaussian(vehicle.start(), jnp.diag(jnp.array([0.1, 0.1, 0.05]) ** 2))
    return Rig(vehicle, (gnss, radio), prior)


def _with(rig: Rig, name: str, **values: Any) -> Rig:
    sensors = tuple(
        dataclasses.replace(s, **values) if s.name == name else s for s in rig.sensors
    )
    return dataclasses.replace(rig, sensors=sensors)


def _true_scale(rig: Rig) -> Rig:
    true = Unicycle(speed_scale=0.95, speed_noise=0.05, yaw_rate_noise=0.02)
    return dataclasses.replace(rig, vehicle=StopAndGo(true))


def _correlated(rig: Rig) -> Rig:
    return with_errors(_with(rig, "gnss", error=CorrelatedError(0.3, 10.0)))


TRUE_RIGS: dict[str, Callable[[Rig], Rig]] = {
    "odometry scale 5 % off": _true_scale,
    "noise 3 times too small": lambda rig: _with(rig, "radio", sensor=_louder(rig)),
    "correlated error": _correlated,
    "lever arm off by 0.3 m": lambda rig: _with(rig, "gnss", mount=Mount(x=0.3)),
}
"""What the vehicle and its sensors really are, where the rig says otherwise."""
FAULTS = {
    "clock off by 0.15 s": Fault("clock", "radio", Clock(offset=0.15)),
    "stuck sensor": Fault("stuck", "gnss", Stuck(), windows=((70.0, 90.0),)),
}
"""What becomes of readings on the way."""
PLANTED = {
    "odometry scale 5 % off": ("scale", "control"),
    "clock off by 0.15 s": ("clock", "radio"),
    "noise 3 times too small": ("noise", "radio"),
    "correlated error": ("error", "gnss"),
    "yaw rate of the other sign": ("sign", "control"),
    "two anchors exchanged": ("exchange", "radio"),
    "lever arm off by 0.3 m": ("arm", "gnss"),
    "stuck sensor": ("stuck", "gnss"),
}
"""All that can be planted, and what a check should call it: kind and subject."""


def planted(
    fault: str | None, key: PRNGKeyArray, duration: float = DURATION
) -> tuple[Recording, Rig]:
    """A simulated log with a fault, or none, and the rig that knows nothing of it.

    Raises:
        ConfigError: there is no such fault.
    """
    if fault is not None and fault not in PLANTED:
        raise ConfigError(unknown("planted fault", fault, list(PLANTED)))
    rig = good()
    true = TRUE_RIGS[fault](rig) if fault in TRUE_RIGS else rig
    faults = (FAULTS[fault],) if fault in FAULTS else ()
    recording, _ = record(Scenario(true, duration=duration, faults=faults), key)
    log = recording.log
    if fault == "yaw rate of the other sign":
        controls = log.controls._replace(yaw_rate=-log.controls.yaw_rate)
        log = log._replace(controls=controls)
    if fault == "two anchors exchanged":
        radio = log.readings[1]
        target = jnp.asarray([1, 0, 2, 3, 4])[radio.target]
        log = log._replace(readings=(log.readings[0], radio._replace(target=target)))
    return recording._replace(log=log), rig


def _louder(rig: Rig) -> Any:
    return dataclasses.replace(rig.sensors[1].sensor, range_std=0.3)
