"""Scenario files: a rig in a simulated world, how it is scored, and what others published."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_type_hints

from pydantic import Field

from kedge.config.building import (
    build_installation,
    build_prior,
    build_rig,
    build_sensor,
    build_vehicle,
)
from kedge.config.fault_config import FaultConfig, Span
from kedge.config.filters import build_filter
from kedge.config.models import Parameter, build_model, model_errors
from kedge.config.motion import Finite, Positive, VehicleConfig
from kedge.config.published import ClaimConfig, ExpectedConfig, PublishedConfig, QuotedConfig
from kedge.config.rigs import AbstractRigConfig, load_config, shipped
from kedge.core.contracts import AbstractFilter, AbstractVehicle
from kedge.core.errors import ContractError, KedgeError
from kedge.core.manifolds import space_of
from kedge.core.registry import routes, sensors, unknown, vehicles, worlds
from kedge.filters.wrappers.carried import carrying
from kedge.formats.toml import Strict
from kedge.simulation.faults import CONTROL, validation_error
from kedge.simulation.routes import AbstractRoute, Facing
from kedge.simulation.scenario import FEEDBACKS, AbstractWorld, LoopFilter, Scenario
from kedge.vehicles.augmented import sharing_augmented

MOST_STEPS = 1e7
"""More steps than this in one run is a wrong dt rather than a long scenario."""

NotNegative = Annotated[Finite, Field(ge=0)]


class RunsConfig(Strict):
    """What is simulated, and how it is scored; all times are in s.

    ``score`` is "pooled" (root of the mean squared error over runs and times) or
    "time-mean-rms" (mean over analysis times of the root mean square over the state: "rmse.a").
    ``start`` "prior" draws the truth from the prior, and filters start from the prior; with
    "truth" they start from the true state with an error drawn from the prior's covariance.
    The truth is drawn ``spin_up`` before time 0. A guided world is steered by ``feedback``:
    "none", "truth", "readings", "filter" (each filter of the study in a loop of its own), or
    one filter by its name. Filters are judged by ``field`` of the state; if it is not named,
    by the position or whatever comes first. ``carried`` are fields of the state that no filter
    estimates: they are integrated from what it does.

    ``names`` are short names for filters with their parameters, used wherever one is named.
    ``featured`` are the filters whose tracks a report shows, in this order from below; if none
    is named, up to four, one of a family. ``chunk`` is how many runs are done in one batch: of
    short runs many, since each batch has its price.
    """

    title: str
    source: str
    duration: Positive
    dt: Positive = 0.1
    spin_up: NotNegative = 0.0
    burn_in: NotNegative = 0.0
    runs: Annotated[int, Field(ge=1)] = 100
    chunk: Annotated[int, Field(ge=1)] = 16
    seed: Annotated[int, Field(ge=0)] = 0
    start: Literal["prior", "truth"] = "prior"
    feedback: str = "none"
    score: Literal["pooled", "time-mean-rms"] = "pooled"
    field: str = ""
    carried: list[str] = []
    filters: Annotated[list[str], Field(min_length=1)]
    names: dict[str, str] = {}
    featured: list[str] = []
    panels: list[str] = []
    """Filters whose first run is drawn by itself: x and y over time, and in plan."""

    def validation_errors(self) -> Iterator[str]:
        """Times that do not go together, filters that cannot be built."""
        if self.dt > self.duration:
            yield f"dt: found {self.dt:g} s, expected at most the duration, {self.duration:g} s"
        if self.duration / self.dt > MOST_STEPS:
            yield (
                f"dt: found {self.dt:g} s, which makes {self.duration / self.dt:.1g} steps; "
                f"expected at most {MOST_STEPS:.0e}"
            )
        if self.burn_in >= self.duration:
            yield (
                f"burn_in: found {self.burn_in:g} s, expected less than the duration, "
                f"{self.duration:g} s"
            )
        yield from self.naming_errors("filters", self.filters)
        if strange := [name for name in self.featured if name not in self.filters]:
            yield f"featured: found {strange}, expected some of the filters, {self.filters}"
        if strange := [name for name in self.panels if name not in self.filters]:
            yield f"panels: found {strange}, expected some of the filters, {self.filters}"
        for name, spec in self.names.items():
            yield from filter_errors(f"names.{name}", [spec])
        if self.feedback not in FEEDBACKS:
            yield from self.naming_errors("feedback", [self.feedback])

    def naming_errors(self, key: str, names: Mapping[str, Any] | list[str]) -> Iterator[str]:
        """Filters that are named twice, or that nobody knows."""
        yield from filter_errors(key, names, self.names)

    def filter_of(self, name: str) -> AbstractFilter:
        """A filter by its short name or as it is typed, with what it carries along.

        Raises:
            KedgeError: there is no such filter.
        """
        return carrying(build_filter(self.names.get(name, name)), self.carried)


class RouteConfig(Strict):
    """Where a world's vehicle ought to be; with ``facing``, its heading towards a point (m)."""

    model: str
    parameters: dict[str, Parameter] = {}
    facing: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None = None

    def validation_errors(self) -> Iterator[str]:
        """Unknown names, and what the route refuses."""
        wrong = list(model_errors(routes, self.model, self.parameters))
        yield from wrong
        if not wrong:
            try:
                self.build()
            except ContractError as error:
                yield f"parameters: {error}"

    def build(self) -> AbstractRoute:
        """The route."""
        route = build_model(routes.get(self.model), self.parameters)
        if self.facing is None:
            return route
        x, y = self.facing
        return Facing(route, (x, y))


class WorldConfig(Strict):
    """What really moves, where that is not the rig's own vehicle on its own drive."""

    model: str
    parameters: dict[str, Parameter] = {}
    route: RouteConfig | None = None

    def validation_errors(self) -> Iterator[str]:
        """Unknown names, a route that is missing or that the world cannot use."""
        wrong = list(model_errors(worlds, self.model, self.parameters))
        yield from wrong
        if wrong and wrong[0].startswith("model"):
            return
        cls = worlds.get(self.model)
        fields = {field.name: field for field in dataclasses.fields(cls)}
        if "route" not in fields:
            if self.route is not None:
                yield f"route: world {self.model!r} has no route; leave this key out"
            return
        if self.route is None:
            if fields["route"].default is dataclasses.MISSING:
                yield f"route: this key is missing; world {self.model!r} follows a route"
            return
        wanted, route = get_type_hints(cls)["route"], self.route.build()
        if not isinstance(route, wanted):
            yield (
                f"route: found a {type(route).__name__}, but world {self.model!r} follows a "
                f"{wanted.__name__}"
            )

    def build(self) -> AbstractWorld:
        """The world."""
        others = {} if self.route is None else {"route": self.route.build()}
        return build_model(worlds.get(self.model), self.parameters, **others)


class ScenarioConfig(AbstractRigConfig):
    """A scenario file."""

    scenario: RunsConfig
    world: WorldConfig | None = None
    vehicles: dict[str, VehicleConfig] = {}
    """The motion models of filters, by name, that have not the rig's; they share its augmented
    states."""
    published: dict[str, PublishedConfig] = {}
    quoted: list[QuotedConfig] = []
    expected: list[ExpectedConfig] = []
    claims: list[ClaimConfig] = []
    errata: list[str] = []
    """Mistakes of the source that matter to who uses it."""
    faults: dict[str, FaultConfig] = {}
    windows: dict[str, list[Span]] = {}
    """Stretches of time (from, to; s) that are scored apart, by name."""

    def ids_of(self, sensor: str) -> list[str]:
        """Of the targets on a sensor's map; none without one."""
        spec = self.sensors.get(sensor)
        targets = None if spec is None or spec.map is None else self.maps.get(spec.map)
        return [] if targets is None else list(targets.ids)

    def control_errors(self, control: Any) -> Iterator[str]:
        """Keys that belong to logs: a scenario drives as its vehicle's ``drive`` says."""
        spaces = {n: space_of(sensors.get(s.model).measures) for n, s in self.sensors.items()}
        for name, spec in self.faults.items():
            if wrong := validation_error(
                spec.build(name), {CONTROL: space_of(control)} | spaces
            ):
                yield f"faults.{name}.{wrong}"
            if strange := [t for t in spec.targets if t not in self.ids_of(spec.on)]:
                ids = self.ids_of(spec.on)
                wanted = f"some of {ids}" if ids else "no targets: that sensor has no map"
                yield f"faults.{name}.targets: found {strange}, expected {wanted}"
        for name, sensor in self.sensors.items():
            log_keys = ("source", "columns", "target", "ignore_targets", "std", "covariance")
            for key in log_keys:
                if getattr(sensor, key):
                    yield f"sensors.{name}.{key}: a scenario reads no log; leave this key out"
            if sensor.map is not None and sensor.map not in self.maps:
                yield (
                    f"sensors.{name}.map: found {sensor.map!r}, expected one of "
                    f"{list(self.maps)}; a scenario has no log to take it from"
                )
        both = [name for name in self.vehicle.true_parameters if name in self.vehicle.augmented]
        if both and self.world is None:
            yield (
                f"vehicle.true_parameters: found {both}, which are augmented; without a world "
                "their true values are drawn from the prior"
            )
        if self.prior.from_truth:
            yield (
                "prior.from_truth: a scenario has no log to take it from; "
                'leave this key out (scenario.start = "truth" starts near the truth)'
            )
        yield from self.scenario.naming_errors("published", list(self.published))
        yield from self.scenario.naming_errors("vehicles", list(self.vehicles))
        fields = type(vehicles.get(self.vehicle.model)().start())._fields
        for name in self.scenario.carried:
            if name not in fields:
                what = unknown("field of the state", name, list(fields))
                yield f"scenario.carried: {what}"
        for name, spec in self.vehicles.items():
            if spec.augmented:
                yield (
                    f"vehicles.{name}.augmented: leave this key out; motion models of filters "
                    "share the augmented states of the rig's vehicle"
                )


class Setting(NamedTuple):
    """A scenario file, read and built."""

    config: ScenarioConfig
    scenario: Scenario
    vehicles: Mapping[str, AbstractVehicle] = {}
    """The motion models of filters that have not the rig's."""


def filter_errors(
    key: str, specs: Mapping[str, Any] | list[str], short: Mapping[str, str] = {}
) -> Iterator[str]:
    """Filters that are named twice or cannot be built, each as ``key: message``."""
    names = list(specs)
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"{key}: found {name!r} twice, expected each filter once"
    for name in dict.fromkeys(names):
        if name in short:
            continue
        try:
            build_filter(name)
        except KedgeError as error:
            yield f"{key}: {error}"


def shipped_scenarios() -> list[str]:
    """The names of the scenarios that come with kedge."""
    return shipped("scenarios")


def load_scenario(name: str, overrides: Mapping[str, str] | None = None) -> Setting:
    """Read a shipped scenario by name, or a TOML file by path.

    Args:
        name: one without a slash or ``.toml`` is that of a shipped scenario.
        overrides: dotted key -> value as TOML, in place of what the file says.

    Raises:
        UnknownName: no scenario of that name is shipped.
        ConfigError: the file is missing or wrong; one line for each mistake.
        ContractError: vehicle, sensors and prior do not fit together.
    """
    return build_setting(load_config("scenarios", name, ScenarioConfig, overrides))


def build_setting(config: ScenarioConfig) -> Setting:
    """Build what a scenario file describes.

    Raises:
        ContractError: vehicle, sensors and prior do not fit together.
    """
    bare, vehicle = build_vehicle(config, {})
    sensors = tuple(
        build_installation(
            config,
            name,
            build_sensor(config, name, {}),
            build_sensor(config, name, {}, spec.true_parameters)
            if spec.true_parameters
            else None,
        )
        for name, spec in config.sensors.items()
    )
    rig = build_rig(config, vehicle, sensors, build_prior(config, bare, vehicle, {}))
    about = config.scenario
    world = None if config.world is None else config.world.build()
    feedback, loop_filter = about.feedback, None
    if feedback not in FEEDBACKS:
        loop_filter, feedback = LoopFilter(about.filter_of(feedback), feedback), "filter"
    vehicles_by_filter = {
        name: sharing_augmented(build_model(vehicles.get(spec.model), spec.parameters), vehicle)
        for name, spec in config.vehicles.items()
    }
    try:
        scenario = Scenario(
            rig,
            about.duration,
            about.dt,
            about.spin_up,
            world,
            feedback,
            loop_filter,
            tuple(s.build(name, config.ids_of(s.on)) for name, s in config.faults.items()),
            _true_vehicle(config),
            config.vehicle.true_from,
        )
    except ContractError as error:
        raise ContractError(f"{config.origin}: {error}") from error
    return Setting(config, scenario, vehicles_by_filter)


def _true_vehicle(config: ScenarioConfig) -> AbstractVehicle | None:
    """The vehicle with its true parameters, if they are others than filters take for true."""
    about = config.vehicle
    if not about.true_parameters:
        return None
    return build_model(vehicles.get(about.model), about.parameters | about.true_parameters)
