"""What a scenario file quotes of the literature: figures, bands, claims with their tests."""

from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from kedge.config.models import Parameter
from kedge.config.motion import Finite, Positive
from kedge.core.conditions import parse_condition, parse_term
from kedge.core.errors import KedgeError
from kedge.formats.toml import Strict


class PublishedConfig(Strict):
    """A score from the literature; its source, if it is not that of the scenario."""

    rmse: Positive
    source: str = ""


class ExpectedConfig(Strict):
    """Where a score should lie, and who says so: ``kalman.all_steps.rmse.position``."""

    score: str
    between: Annotated[list[Finite], Field(min_length=2, max_length=2)]
    source: str = ""

    def validation_errors(self) -> Iterator[str]:
        """A score that cannot be understood, a band upside down."""
        yield from condition_errors("score", parse_term, self.score)
        if self.between[0] > self.between[1]:
            yield f"between: found {self.between}, expected the lower end first"


class QuotedConfig(Strict):
    """A figure from the source, to stand beside the same score here."""

    score: str
    value: Finite
    source: str

    def validation_errors(self) -> Iterator[str]:
        """A score that cannot be understood."""
        yield from condition_errors("score", parse_term, self.score)


class ClaimConfig(Strict):
    """What somebody states, and the condition on the scores by which it stands or falls.

    Without a ``test`` these filters at these settings cannot tell; ``means`` says what can.
    """

    text: str
    source: str
    test: str = ""
    means: str = ""
    """What the test measures, and what follows from its outcome."""
    outcome: Literal["", "true", "false"] = ""
    """The only verdict under which ``means`` is right, if it speaks of one."""
    under: dict[str, Parameter] = {}
    """Settings that the claim is about, by dotted key: under others it is not judged."""

    def validation_errors(self) -> Iterator[str]:
        """A test that cannot be understood."""
        if self.test:
            yield from condition_errors("test", parse_condition, self.test)
        elif not self.means:
            yield "means: this key is missing; a claim without a test says here what decides it"


def condition_errors(key: str, parse: Callable[[str], Any], text: str) -> Iterator[str]:
    """A condition that cannot be read, as ``key: message``."""
    try:
        parse(text)
    except KedgeError as error:
        yield f"{key}: {error}"
