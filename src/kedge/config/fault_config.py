"""What a scenario file says of faults."""

from collections.abc import Iterator, Sequence
from typing import Annotated

from pydantic import Field

from kedge.config.models import Parameter, build_model, model_errors
from kedge.config.motion import Finite, Positive
from kedge.core.errors import ContractError
from kedge.core.registry import faults
from kedge.formats.toml import Strict
from kedge.simulation.faults import Episodes, Fault

Span = Annotated[list[Finite], Field(min_length=2, max_length=2)]
"""From, to; s."""


class EpisodesConfig(Strict):
    """Stretches that begin ``rate`` times a second and last ``duration`` s, in the mean."""

    rate: Positive
    duration: Positive

    def build(self) -> Episodes:
        """The episodes."""
        return Episodes(self.rate, self.duration)


class FaultConfig(Strict):
    """What goes wrong with a sensor, or with what filters are told of the control, and when."""

    on: str
    model: str
    parameters: dict[str, Parameter] = {}
    targets: list[str] = []
    """Ids on the sensor's map; a fault of all of them if there are none."""
    windows: list[Span] = []
    episodes: EpisodesConfig | None = None

    def validation_errors(self) -> Iterator[str]:
        """Unknown names, and what the fault refuses."""
        wrong = list(model_errors(faults, self.model, self.parameters))
        yield from wrong
        if not wrong:
            try:
                self.build("")
            except ContractError as error:
                yield f"parameters: {error}"

    def build(self, name: str, ids: Sequence[str] = ()) -> Fault:
        """The fault, on a sensor whose map has these ids."""
        kind = build_model(faults.get(self.model), self.parameters)
        windows = tuple((begin, end) for begin, end in self.windows)
        episodes = self.episodes and self.episodes.build()
        targets = tuple(ids.index(target) for target in self.targets if target in ids)
        return Fault(name, self.on, kind, windows, episodes, targets)
