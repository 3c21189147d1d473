"""Rig files: TOML checked as a whole, so that every mistake is reported at once, with its key.

Model, parameter, component and field names are checked against the registered classes here,
before any data is read.
"""

import abc
import dataclasses
import os
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar

import jax
import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, WithJsonSchema

from kedge.config.filters import build_filter
from kedge.config.inheritance import completed
from kedge.config.models import Parameter, build_model, model_errors
from kedge.config.motion import ControlConfig, Finite, Positive, VehicleConfig
from kedge.config.plugins import load_modules
from kedge.config.prior_checks import attitude_errors, covariance_errors
from kedge.core.errors import ConfigError, ContractError, KedgeError, UnknownName
from kedge.core.manifolds import Chart, charts_of, space_of
from kedge.core.registry import sensors, unknown, vehicles
from kedge.formats.bag_config import BagConfig
from kedge.formats.odometry import POSE, TWIST
from kedge.formats.origin import OriginConfig
from kedge.formats.toml import Strict, read_toml
from kedge.numerics.losses import Kind, Side


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, int | float) else value


_NUMBERS = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}
Numbers = Annotated[list[Finite], BeforeValidator(_listed), WithJsonSchema(_NUMBERS)]
Spreads = Annotated[list[Positive], BeforeValidator(_listed), WithJsonSchema(_NUMBERS)]


class MountConfig(Strict):
    """Where a sensor sits on the body (m: forward, left, up), and how it is turned (rad)."""

    x: Finite = 0.0
    y: Finite = 0.0
    z: Finite = 0.0
    heading: Finite = 0.0
    pitch: Finite = 0.0
    roll: Finite = 0.0


class RobustConfig(Strict):
    """How readings far from the prediction are weighed down."""

    loss: Kind = "student"
    tuning: Positive | None = None
    side: Side = "both"


class SensorConfig(Strict):
    """One installed sensor and where its readings are."""

    model: str
    source: str | None = None
    columns: dict[str, str] = {}
    target: str | None = None
    map: str | None = None
    ignore_targets: list[str] = []
    parameters: dict[str, Parameter] = {}
    latency: Annotated[Finite, Field(ge=-3600, le=3600)] = 0.0
    rate: Positive | None = None
    all_targets: bool = False
    true_parameters: dict[str, Parameter] = {}
    gate: Annotated[Finite, Field(gt=0, lt=1)] | None = None
    robust: RobustConfig | None = None
    recovery: Annotated[float, Field(gt=0)] | None = None
    allowed_silence: Positive | None = None
    mount: MountConfig | None = None
    std: dict[str, str] = {}
    covariance: list[str] | None = None

    def validation_errors(self) -> Iterator[str]:
        """Unknown names, and keys that do not go together."""
        wrong = list(model_errors(sensors, self.model, self.parameters))
        yield from wrong
        if wrong and wrong[0].startswith("model"):
            return
        for line in model_errors(sensors, self.model, self.parameters | self.true_parameters):
            if line not in wrong:
                yield line.replace("parameters.", "true_parameters.", 1)
        cls = sensors.get(self.model)
        parts = list(space_of(cls.measures).column_units)
        for key in ("columns", "std"):
            for name in getattr(self, key):
                if name not in parts:
                    yield f"{key}.{name}: {unknown('measurement component', name, parts)}"
        if self.std and (absent := [part for part in parts if part not in self.std]):
            yield f"std: found {list(self.std)}, expected a column for {absent} too"
        size = space_of(cls.measures).size
        if self.covariance is not None and len(self.covariance) != size * (size + 1) // 2:
            yield (
                f"covariance: found {len(self.covariance)} columns, expected the "
                f"{size * (size + 1) // 2} of the upper triangle for {', '.join(parts)}"
            )
        if self.covariance is not None and self.std:
            yield "covariance: found beside std, expected one of the two"
        has_map = "target" in {field.name for field in dataclasses.fields(cls)}
        if has_map and self.map is None:
            yield f"map: this key is missing; sensor {self.model!r} needs a map of targets"
        for key in () if has_map else ("map", "target", "ignore_targets"):
            if getattr(self, key):
                yield f"{key}: sensor {self.model!r} has no targets; leave this key out"


class MapConfig(Strict):
    """A map of targets, in SI units and ENU."""

    ids: list[str]
    columns: dict[str, list[Finite]]

    def validation_errors(self) -> Iterator[str]:
        """No target, columns of another length, targets that are listed twice."""
        if not self.ids:
            yield "ids: found no target, expected at least one"
        for name, values in self.columns.items():
            if len(values) != len(self.ids):
                yield f"columns.{name}: found {len(values)} values, expected {len(self.ids)}"
        if twice := sorted({name for name in self.ids if self.ids.count(name) > 1}):
            yield f"ids: found {twice[0]!r} twice, expected each target once"


class PriorConfig(Strict):
    """What is believed at the start."""

    from_truth: list[str] = []
    source: str | None = None
    """Where ``from_truth`` takes the start from, if not from the truth."""
    mean: dict[str, Numbers] = {}
    std: dict[str, Spreads] = {}
    covariance: list[list[Finite]] | None = None


class FilterConfig(Strict):
    """The filter, with its parameters after a colon."""

    name: str = "extended"

    def validation_errors(self) -> Iterator[str]:
        """What is wrong with the name."""
        try:
            build_filter(self.name)
        except KedgeError as error:
            yield f"name: {error}"


class TruthConfig(Strict):
    """What the truth of a log is compared with."""

    own_frame: bool = False
    """Its frame is not that of the map: it is moved onto the estimate before comparing."""


class OutputConfig(Strict):
    """When the estimate is written, in Hz."""

    rate: Positive = 10.0


class StandingConfig(Strict):
    """Whose word it takes that a vehicle stands, and how still it must be over a window (s).

    Both have to agree. A wheel alone says so when its encoder is dead or it is lifted, an IMU
    alone when the vehicle glides at constant speed on a smooth floor.
    """

    imu: str = "imu"
    wheel: str
    column: str = "speed"
    window: Positive = 1.0
    speed: Positive = 0.01  # m/s
    force_std: Positive = 0.1  # m/s^2
    rate_std: Positive = 0.01  # rad/s
    rate: Positive = 10.0  # Hz, of the readings that it makes


class AbstractRigConfig(Strict):
    """What rigs and scenarios share: a vehicle, its sensors and what is believed at first."""

    modules: list[str] = []
    """Python files with vehicles, sensors and filters of your own, relative to this file."""
    vehicle: VehicleConfig
    sensors: dict[str, SensorConfig] = {}
    maps: dict[str, MapConfig] = {}
    prior: PriorConfig = PriorConfig()
    _origin: str = PrivateAttr("")

    @property
    def origin(self) -> str:
        """The file, for messages."""
        return self._origin

    def validation_errors(self) -> Iterator[str]:
        """Parameters that the vehicle refuses, a prior that does not fit its state."""
        try:
            vehicle = build_model(vehicles.get(self.vehicle.model), self.vehicle.parameters)
        except (ContractError, TypeError) as error:
            yield f"vehicle.model: {error}"
            return
        yield from self.control_errors(type(vehicle.nominal_control(0.0)))
        yield from self._prior_complaints(charts_of(type(vehicle.start())))

    @abc.abstractmethod
    def control_errors(self, control: Any) -> Iterator[str]:
        """What is wrong with where the control comes from."""

    def _prior_complaints(self, charts: dict[str, Chart]) -> Iterator[str]:
        prior, fields = self.prior, [*charts, *self.vehicle.augmented]
        known = {"std": list(charts), "mean": fields, "from_truth": list(charts)}
        for key, names in known.items():
            for name in getattr(prior, key):
                if name not in names:
                    yield f"prior.{key}.{name}: {unknown('field of the state', name, names)}"
        sizes = {
            "std": {name: chart.size for name, chart in charts.items()},
            "mean": {name: int(np.prod(chart.shape)) for name, chart in charts.items()},
        }
        for key, wanted in sizes.items():
            for name, values in getattr(prior, key).items():
                size = wanted.get(name, len(values))
                if key == "mean" and name in charts and size > charts[name].size:
                    yield from attitude_errors(f"prior.mean.{name}", values)
                elif len(values) not in (1, size):
                    yield (
                        f"prior.{key}.{name}: found {len(values)} numbers, expected 1 or {size}"
                    )
        if prior.covariance is None:
            for name in charts:
                if name not in prior.std:
                    yield f"prior.std.{name}: this key is missing"
            return
        if prior.std:
            yield "prior.covariance: found beside prior.std, expected one of the two"
        yield from covariance_errors(prior.covariance, sum(c.size for c in charts.values()))


class RigConfig(AbstractRigConfig):
    """A vehicle, its sensors, where their readings stand in a log, and a filter."""

    title: str = ""
    format: str = "folder"
    bag: BagConfig | None = None
    map_origin: OriginConfig | None = None
    truth: TruthConfig = TruthConfig()
    control: ControlConfig | None = None
    standing: StandingConfig | None = None
    filter: FilterConfig = FilterConfig()
    output: OutputConfig = OutputConfig()

    def control_errors(self, control: Any) -> Iterator[str]:
        """A control that is missing, or has components that the vehicle does not know."""
        driven = list(space_of(control).column_units)
        if driven and self.control is None:
            yield (
                f"control: this key is missing; vehicle {self.vehicle.model!r} is driven by "
                f"{', '.join(driven)}"
            )
        if self.control and self.control.sampling == "poses":
            if strange := [name for name in driven if name not in TWIST]:
                yield (
                    f"control.sampling: poses tell no {strange[0]}, by which vehicle "
                    f"{self.vehicle.model!r} is driven; expected speeds and a yaw rate"
                )
            driven = list(POSE)
        for name in self.control.columns if self.control else ():
            if name not in driven:
                yield f"control.columns.{name}: {unknown('control component', name, driven)}"


def shipped(kind: str) -> list[str]:
    """The names of the files that come with kedge, of a kind: "rigs" or "scenarios"."""
    files = resources.files("kedge").joinpath(kind).iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


def shipped_rigs() -> list[str]:
    """The names of the rigs that come with kedge."""
    return shipped("rigs")


C = TypeVar("C", bound=AbstractRigConfig)


def load_config(
    kind: str, name: str, model: type[C], overrides: Mapping[str, str] | None = None
) -> C:
    """Read a shipped file of a ``kind`` ("rigs", "scenarios") by name, or a file by path.

    It may say only in what it differs from another: see
    :func:`kedge.config.inheritance.completed`.

    Raises:
        UnknownName: none of that name is shipped.
        ConfigError: the file is missing or wrong; one line for each mistake.
    """
    _require_platform()
    path = Path(name)

    def whole(tree: dict[str, Any], place: Path) -> dict[str, Any]:
        with resources.as_file(resources.files("kedge")) as folder:
            known = {n: folder / "rigs" / f"{n}.toml" for n in shipped("rigs")}
            if kind != "rigs":  # which a scenario may extend, too
                known |= {n: folder / kind / f"{n}.toml" for n in shipped(kind)}
            return completed(tree, place, known)

    if path.suffix == ".toml" or len(path.parts) > 1:
        load_modules(path)
        config = read_toml(path, model, overrides, complete=whole)
    elif name not in shipped(kind):
        raise UnknownName(unknown(kind.removesuffix("s"), name, shipped(kind)))
    else:
        place = resources.files("kedge").joinpath(kind, f"{name}.toml")
        with resources.as_file(place) as path:
            config = read_toml(path, model, overrides, complete=whole)
    config._origin = str(path)
    return config


def _require_platform() -> None:
    """Refuse a platform that JAX cannot use here, before a file is blamed for it."""
    try:
        jax.devices()
    except Exception as error:
        # JAX raises RuntimeError or AssertionError, depending on what is missing.
        wanted = os.environ.get("JAX_PLATFORMS", "")
        raise ConfigError(
            f"JAX_PLATFORMS={wanted}: JAX cannot compute on this platform: "
            f"{str(error).partition(chr(10))[0] or type(error).__name__}; "
            "expected one that is here, such as cpu"
        ) from error


def load_rig_config(rig: str, overrides: Mapping[str, str] | None = None) -> RigConfig:
    """Read a shipped rig by name, or a TOML file by path.

    Args:
        rig: a name without a slash or ``.toml`` is that of a shipped rig.
        overrides: dotted key -> value as TOML, in place of what the file says.

    Raises:
        UnknownName: no rig of that name is shipped.
        ConfigError: the file is missing or wrong; one line for each mistake.
    """
    return load_config("rigs", rig, RigConfig, overrides)


def rig_schema() -> dict[str, Any]:
    """The JSON schema of rig files."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | (
        RigConfig.model_json_schema()
    )
