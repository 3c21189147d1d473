"""The tables of a rig file that are about sensors, what is believed at first, and outputs."""

import dataclasses
from collections.abc import Iterator
from math import inf
from typing import Annotated, Any

import jax.numpy as jnp
from pydantic import BeforeValidator, Field, WithJsonSchema

from kedge.config.filters import build_filter
from kedge.config.models import Parameter, model_errors
from kedge.config.motion import Finite, Positive
from kedge.core.errors import KedgeError
from kedge.core.manifolds import space_of
from kedge.core.registry import sensors, unknown
from kedge.estimation.correlated_error import CorrelatedError, Treatment
from kedge.formats.toml import Strict
from kedge.numerics.losses import Kind, Side


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, int | float) else value


_NUMBERS = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}
Numbers = Annotated[list[Finite], BeforeValidator(_listed), WithJsonSchema(_NUMBERS)]
NotNegative = Annotated[Finite, Field(ge=0)]
Lasting = Annotated[float, Field(gt=0)]
NotNegatives = Annotated[list[NotNegative], BeforeValidator(_listed), WithJsonSchema(_NUMBERS)]
Times = Annotated[list[Lasting], BeforeValidator(_listed), WithJsonSchema(_NUMBERS)]
Spreads = Annotated[list[Positive], BeforeValidator(_listed), WithJsonSchema(_NUMBERS)]


class MountConfig(Strict):
    """Where a sensor sits on the body (m: forward, left, up), and how it is turned (rad)."""

    x: Finite = 0.0
    """m forward."""
    y: Finite = 0.0
    """m to the left."""
    z: Finite = 0.0
    """m up."""
    heading: Finite = 0.0
    """rad, to the left."""
    pitch: Finite = 0.0
    """rad, nose down."""
    roll: Finite = 0.0
    """rad, right side down."""


class RobustConfig(Strict):
    """How readings far from the prediction are weighed down."""

    loss: Kind = "student"
    """Which loss; "student" is of heavy tails."""
    tuning: Positive | None = None
    """Where it begins to weigh down; its usual value if not given."""
    side: Side = "both"
    """Whether readings that are too large, too small or both are doubted."""


class ErrorConfig(Strict):
    """What a sensor errs by beside its white noise: a bias that fades within some seconds."""

    std: NotNegatives
    """Its standard deviation, in the unit of what is measured; one or one each."""
    time_constant: Times
    """s after which 1/e of it remains; one or one each; inf is a constant."""
    by_target: bool | None = None
    """Whether each target of the map has its own, as if not given; else all share one."""
    considered: bool = False
    """Whether it widens what is believed, but is not estimated."""
    widened: bool = False
    """Whether it only widens the noise of each reading, by how many readings it lasts."""

    def validation_errors(self) -> Iterator[str]:
        """Two treatments at once; a constant that no noise can stand for."""
        if self.considered and self.widened:
            yield "widened: found beside considered, expected one of the two"
        if self.widened and inf in self.time_constant:
            yield "time_constant: found inf, expected a finite one with widened"

    def build(self, has_map: bool) -> CorrelatedError:
        """The error; by target where there are targets, unless it says otherwise."""
        treatment: Treatment = "considered" if self.considered else "estimated"
        std, memory = (
            jnp.asarray(values if len(values) > 1 else values[0])
            for values in (self.std, self.time_constant)
        )
        return CorrelatedError(
            std,
            memory,
            has_map if self.by_target is None else self.by_target,
            "widened" if self.widened else treatment,
        )


class SensorConfig(Strict):
    """One installed sensor and where its readings are."""

    model: str
    """Its model: `kedge list sensors`."""
    source: str | None = None
    """The log's source; called as the sensor is, if not given."""
    columns: dict[str, str] = {}
    """Component of the measurement -> column, where they differ; a number is a constant."""
    target: str | None = None
    """The column that names what was seen; "target" if not given."""
    map: str | None = None
    """The map of its targets: of this file, or of the log."""
    ignore_targets: list[str] = []
    """Targets whose readings are left out."""
    parameters: dict[str, Parameter] = {}
    """Parameters of the model, in SI units."""
    latency: Annotated[Finite, Field(ge=-3600, le=3600)] = 0.0
    """s from the event to its stamp."""
    rate: Positive | None = None
    """Hz, in simulation; as the model says, if not given."""
    all_targets: bool = False
    """Whether, in simulation, it reads all targets at once, not in turn."""
    true_parameters: dict[str, Parameter] = {}
    """What the parameters are in simulation, where filters take others for true."""
    gate: Annotated[Finite, Field(gt=0, lt=1)] | None = None
    """Share of good readings that may be refused; no gate if not given."""
    robust: RobustConfig | None = None
    """How readings far from the prediction are weighed down."""
    recovery: Annotated[float, Field(gt=0)] | None = None
    """s of nothing but outliers after which a reading is let in; inf is never."""
    allowed_silence: Positive | None = None
    """s without a reading that is fused, after which the estimate counts as degraded."""
    mount: MountConfig | None = None
    """Where it sits on the body."""
    error: ErrorConfig | None = None
    """What it errs by for some seconds, beside its white noise."""
    std: dict[str, str] = {}
    """Component -> column of its standard deviation, of each reading."""
    covariance: list[str] | None = None
    """The columns of the upper triangle of each reading's covariance, by row."""

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
        if self.error is not None and self.error.by_target and not has_map:
            yield f"error.by_target: sensor {self.model!r} has no targets; leave this key out"
        for key in () if has_map else ("map", "target", "ignore_targets"):
            if getattr(self, key):
                yield f"{key}: sensor {self.model!r} has no targets; leave this key out"


class MapConfig(Strict):
    """A map of targets, in SI units and ENU."""

    ids: list[str]
    """Names of the targets."""
    columns: dict[str, list[Finite]]
    """Component (position_x) -> its value for each target."""

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
    """Fields of the state that begin where the truth does."""
    source: str | None = None
    """Where ``from_truth`` takes the start from, if not from the truth."""
    mean: dict[str, Numbers] = {}
    """Field of the state -> its value or values; as the vehicle starts, if not given."""
    std: dict[str, Spreads] = {}
    """Field of the state -> its standard deviation, one or one each."""
    covariance: list[list[Finite]] | None = None
    """Of the whole state, in place of std."""


class FilterConfig(Strict):
    """The filter, with its parameters after a colon."""

    name: str = "extended"
    """A name of `kedge list filters`, with parameters after a colon."""

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
    """Hz."""


class StandingConfig(Strict):
    """Whose word it takes that a vehicle stands, and how still it must be over a window (s).

    Both have to agree. A wheel alone says so when its encoder is dead or it is lifted, an IMU
    alone when the vehicle glides at constant speed on a smooth floor.
    """

    imu: str = "imu"
    """The source of the IMU."""
    wheel: str
    """The source of the wheel."""
    column: str = "speed"
    """The column of the wheel's speed."""
    window: Positive = 1.0
    """s."""
    speed: Positive = 0.01
    """m/s below which the wheel stands."""
    force_std: Positive = 0.1
    """m/s^2 by which a specific force may vary."""
    rate_std: Positive = 0.01
    """rad/s by which an angular rate may vary."""
    rate: Positive = 10.0
    """Hz, of the readings that it makes."""
