"""Rig files: TOML checked as a whole, so that every mistake is reported at once, with its key.

Model, parameter, component and field names are checked against the registered classes here,
before any data is read.
"""

import abc
import os
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from pydantic import PrivateAttr

from kedge.config.inheritance import completed
from kedge.config.models import build_model
from kedge.config.motion import ControlConfig, VehicleConfig
from kedge.config.plugins import load_modules
from kedge.config.prior_checks import attitude_errors, covariance_errors
from kedge.config.sections import (
    FilterConfig as FilterConfig,
)
from kedge.config.sections import (
    MapConfig,
    OutputConfig,
    PriorConfig,
    TruthConfig,
)
from kedge.config.sections import (
    MountConfig as MountConfig,
)
from kedge.config.sections import (
    SensorConfig as SensorConfig,
)
from kedge.config.sections import (
    StandingConfig as StandingConfig,
)
from kedge.core.errors import ConfigError, ContractError, UnknownName
from kedge.core.manifolds import Chart, charts_of, space_of
from kedge.core.registry import unknown, vehicles
from kedge.formats.bag_config import BagConfig
from kedge.formats.odometry import POSE, TWIST
from kedge.formats.origin import OriginConfig
from kedge.formats.toml import Strict, read_toml


class AbstractRigConfig(Strict):
    """What rigs and scenarios share: a vehicle, its sensors and what is believed at first."""

    modules: list[str] = []
    """Python files with vehicles, sensors and filters of your own, relative to this file."""
    vehicle: VehicleConfig
    """The motion model."""
    sensors: dict[str, SensorConfig] = {}
    """The sensors, by name."""
    maps: dict[str, MapConfig] = {}
    """Maps of targets, by name."""
    prior: PriorConfig = PriorConfig()
    """What is believed at the start."""
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
    """What reports are called."""
    format: str = "folder"
    """How the log is read: `kedge list readers`."""
    bag: BagConfig | None = None
    """Which topic of a bag is what."""
    map_origin: OriginConfig | None = None
    """Where the map's origin is, for logs of latitudes and longitudes."""
    truth: TruthConfig = TruthConfig()
    """How the truth is compared with."""
    control: ControlConfig | None = None
    """What drives the vehicle."""
    standing: StandingConfig | None = None
    """How it is known that the vehicle stands."""
    filter: FilterConfig = FilterConfig()
    """The filter."""
    output: OutputConfig = OutputConfig()
    """When the estimate is written."""

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
    kind: str, name: str, model: type[C], overrides: Mapping[str, Any] | None = None
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


def load_rig_config(rig: str, overrides: Mapping[str, Any] | None = None) -> RigConfig:
    """Read a shipped rig by name, or a TOML file by path.

    Args:
        rig: a name without a slash or ``.toml`` is that of a shipped rig.
        overrides: dotted key -> value, in place of what the file says; words as TOML.

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
