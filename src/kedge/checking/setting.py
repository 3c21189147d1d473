"""What could be wrong with a rig on a log, as changes of arrays that compile nothing anew."""

import dataclasses
import math
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kedge.core.manifolds import charts_of, space_of
from kedge.estimation.log import Log, Recording
from kedge.estimation.mount import validation_error
from kedge.estimation.rig import Installation, Mount, Rig
from kedge.tuning.log import Timeline, arranged, timeline
from kedge.tuning.tunable import Tunable, placed

MOST_LATE = 0.6
"""s by which the clock of a sensor is moved at the most."""
CONTROL = "control"

Kind = Literal["scale", "sign", "clock", "arm", "noise", "exchange", "error"]


class Change(NamedTuple):
    """One hypothesis: a sensor, or the control, is not what the rig says of it."""

    kind: Kind
    subject: str
    """A sensor, or "control"; for noise also "vehicle"."""
    part: str = ""
    """The component, the axis of an arm, or the targets that are exchanged."""
    value: float = 0.0
    """Factor less one (scale), s that readings are stamped late (clock), m (arm), logarithm of
    the factor (noise), standard deviations of the white noise (error)."""
    seconds: float = 0.0
    """Time constant of an error."""


class Setting(NamedTuple):
    """A rig and a log, as changes leave them."""

    rig: Rig
    line: Timeline
    later: Float[np.ndarray, " s"]
    """s by which each sensor's readings are earlier than their event times."""
    density: Float[np.ndarray, " s"]
    """By sensor, what its log-likelihoods gain since its readings are in other units."""
    noise: tuple[Tunable, ...]
    """The numbers of the rig that are noise."""
    square: Float[np.ndarray, "s m"]
    """By sensor and component, the mean square of whitened residuals as the rig stands."""
    louder: Float[np.ndarray, " s+1"]
    """By sensor, and last of the vehicle, the logarithm of what its noise is multiplied by."""

    def log(self) -> Log:
        """The events in their order."""
        log = arranged(self.line, self.later).log
        sensor = np.asarray(log.schedule.sensor)
        time = np.asarray(log.schedule.time) - np.append(self.later, 0.0)[sensor]
        schedule = log.schedule._replace(time=jnp.asarray(time))
        return log._replace(schedule=schedule, readings=jax.tree.map(jnp.asarray, log.readings))


def setting_of(rig: Rig, recording: Recording, noise: tuple[Tunable, ...]) -> Setting:
    """A rig and its log as they are; readings that a change may move before it are left out."""
    count = len(rig.sensors)
    widest = max((space_of(one.sensor.measures).size for one in rig.sensors), default=0)
    line = timeline(recording, np.inf, np.full(count, MOST_LATE))
    return Setting(
        with_arms(rig),
        line,
        np.zeros(count),
        np.zeros(count),
        noise,
        np.ones((count, widest)),
        np.zeros(count + 1),
    )


def with_arms(rig: Rig) -> Rig:
    """The rig, with a mount of zero where a sensor may have one and has none."""
    return dataclasses.replace(
        rig,
        sensors=tuple(
            dataclasses.replace(s, mount=Mount()) if s.mount is None and has_arm(rig, s) else s
            for s in rig.sensors
        ),
    )


def has_arm(rig: Rig, installation: Installation) -> bool:
    """Whether where a sensor sits makes a difference to what it reads."""
    state = charts_of(type(rig.prior.mean))
    reads = set(charts_of(installation.sensor.reads))
    swung = "angular_rate" in state and reads & {"velocity", "velocity_body"}
    return bool("position" in reads or swung) and not validation_error(
        Mount(x=1.0), state, reads
    )


def changed(setting: Setting, change: Change) -> Setting:
    """The setting with a hypothesis taken for true: rig and readings are mended by it."""
    kind, name, part, value, _ = change
    if kind == "noise":
        return _noisier(setting, name, value)
    if kind in ("scale", "sign"):
        return _scaled(setting, name, part, -1.0 if kind == "sign" else 1 / (1 + value))
    place = setting.rig.index(name)
    if kind == "clock":
        later = setting.later.copy()
        later[place] += value
        return setting._replace(later=later)
    if kind == "exchange":
        one, other = (int(number) for number in part.split(","))
        readings = setting.line.readings[place]
        target = np.asarray(readings.target)
        swapped = np.where(target == one, other, np.where(target == other, one, target))
        return _with_readings(setting, place, readings._replace(target=swapped))
    installation = setting.rig.sensors[place]
    mount = installation.mount or Mount()
    mount = mount._replace(**{part: getattr(mount, part) + value})
    return setting._replace(
        rig=_with_sensor(setting.rig, place, dataclasses.replace(installation, mount=mount))
    )


def noise_of(setting: Setting, subject: str) -> list[Tunable]:
    """The numbers above 0 that say how noisy a sensor, or the vehicle, is."""
    if subject == "vehicle":
        # A sensor's error is a state of the vehicle too.
        return [
            t for t in setting.noise if t.path[0] == "vehicle" and t.value > 0 and t.unit != "s"
        ]
    path = ("sensors", setting.rig.index(subject))
    return [t for t in setting.noise if t.path[:2] == path and t.value > 0 and t.unit != "s"]


def _noisier(setting: Setting, name: str, value: float) -> Setting:
    place = -1 if name == "vehicle" else setting.rig.index(name)
    louder = setting.louder.copy()
    louder[place] += value
    chosen = noise_of(setting, name)
    values = jnp.asarray([t.value * math.exp(louder[place]) for t in chosen], float)
    setting = setting._replace(rig=placed(setting.rig, chosen, values), louder=louder)
    if place < 0:
        return setting
    readings = setting.line.readings[place]
    if readings.cov is None:
        return setting
    cov = np.asarray(readings.cov) * math.exp(2 * value)
    return _with_readings(setting, place, readings._replace(cov=cov))


def _scaled(setting: Setting, name: str, part: str, factor: float) -> Setting:
    if name == CONTROL:
        controls = scaled(setting.line.controls, part, factor)
        return setting._replace(line=setting.line._replace(controls=controls))
    place = setting.rig.index(name)
    readings = setting.line.readings[place]
    measurement = scaled(readings.measurement, part, factor)
    density = setting.density.copy()
    # A reading in other units has another density, and its noise another size. That is paid
    # for in NIS; where noise is declared too large it would be too cheap: to first order it
    # is the logarithm of the factor times the mean square of whitened residuals.
    component = space_of(type(readings.measurement)).labels.index(part)
    density[place] += setting.square[place, component] * math.log(abs(factor))
    return _with_readings(
        setting._replace(density=density), place, readings._replace(measurement=measurement)
    )


def scaled(values: Any, part: str, factor: float) -> Any:
    """A tree of controls or readings with one component, or all of a field, times a factor."""
    at, fields = 0, {}
    for (field, chart), leaf in zip(charts_of(type(values)).items(), values, strict=True):
        flat = np.asarray(leaf, float).reshape(len(leaf), -1).copy()
        for column in range(flat.shape[1] if chart.shape == chart.tangent_shape else 0):
            if space_of(type(values)).labels[at + column] == part:
                flat[:, column] *= factor
        at += chart.size
        fields[field] = flat.reshape(np.shape(leaf))
    return type(values)(**fields)


def _with_readings(setting: Setting, place: int, readings: Any) -> Setting:
    every = setting.line.readings
    line = setting.line._replace(readings=(*every[:place], readings, *every[place + 1 :]))
    return setting._replace(line=line)


def _with_sensor(rig: Rig, place: int, installation: Installation) -> Rig:
    sensors = (*rig.sensors[:place], installation, *rig.sensors[place + 1 :])
    return dataclasses.replace(rig, sensors=sensors)
