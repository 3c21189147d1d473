"""What a rig file says of a bag: which topic is which source, and where its numbers are."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, field_validator

from kedge.core.errors import DataError
from kedge.core.registry import unknown
from kedge.formats.toml import Strict
from kedge.formats.units import TIME_UNITS, unit_of


class FieldConfig(Strict):
    """A column: the way to it in a message (``pose.position.x``, ``cov[0]``), and its unit."""

    field: str
    """The way to it in a message: pose.position.x, cov[0]."""
    unit: str
    """Its unit."""

    def validation_errors(self) -> Iterator[str]:
        """An unknown unit."""
        try:
            unit_of(self.unit)
        except DataError as error:
            yield f"unit: {error}"


class TopicConfig(Strict):
    """One topic as a source, or as a map of targets."""

    topic: str
    """As the bag calls it."""
    stamp: str = "header.stamp"
    """The way to the stamp, or "bag" for the time at which the message was recorded."""
    stamp_unit: str = "s"
    """Of a stamp that is a plain number."""
    offset: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    """s to add to the stamps, for a clock that differs from the others."""
    each: str | None = None
    """The way to a list in the message, each of whose elements is a row."""
    target: str | None = None
    """The way to the name of the target, from the element if there is ``each``."""
    columns: dict[str, FieldConfig] = {}
    """Column -> { field, unit }."""

    def validation_errors(self) -> Iterator[str]:
        """An unknown unit of time."""
        if self.stamp_unit not in TIME_UNITS:
            yield f"stamp_unit: {unknown('unit of time', self.stamp_unit, list(TIME_UNITS))}"


class BagConfig(Strict):
    """Sources and maps by topic; ``truth`` names one of the sources."""

    topics: dict[str, TopicConfig]
    """Sources by the name that the rig calls them."""
    maps: dict[str, TopicConfig] = {}
    """Maps of targets, from the first message of a topic."""
    truth: str | None = None
    """The source to compare with."""
    base: str = "base_link"
    """The body's frame, from which ``/tf_static`` tells where sensors sit; "" for none."""

    @field_validator("maps")
    @classmethod
    def _named(cls, maps: dict[str, TopicConfig]) -> dict[str, TopicConfig]:
        for name, spec in maps.items():
            if spec.target is None:
                raise ValueError(f"{name}: target is missing: the way to a target's name")
        return maps

    def validation_errors(self) -> Iterator[str]:
        """A truth that is no source."""
        if self.truth is not None and self.truth not in self.topics:
            yield f"truth: {unknown('source', self.truth, list(self.topics))}"
