"""What a rig file says of how a vehicle moves: its model, augmented states and control."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from kedge.config.models import Parameter, model_errors
from kedge.core.registry import vehicles
from kedge.formats.inertial import Sampling
from kedge.formats.toml import Strict

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[Finite, Field(gt=0)]


class AugmentedConfig(Strict):
    """A slowly varying quantity that is estimated with the state."""

    std: Positive
    """What is believed of it at first, in the quantity's unit."""
    random_walk: Annotated[Finite, Field(ge=0)] = 0.0
    """Density of its walk, in its unit per second per root hertz."""
    time_constant: Positive | None = None
    """s in which it comes back to its nominal value; never, if not given."""


class VehicleConfig(Strict):
    """The motion model."""

    model: str
    """Its model: `kedge list vehicles`."""
    parameters: dict[str, Parameter] = {}
    """Parameters of the model, in SI units."""
    true_parameters: dict[str, Parameter] = {}
    """What the parameters are in simulation, where filters take others for true."""
    true_from: Annotated[Finite, Field(ge=0)] = 0.0
    """s from which on they are, such as when a payload comes on."""
    augmented: dict[str, AugmentedConfig] = {}
    """Parameters of the vehicle, or biases that a sensor reads, that are estimated."""

    def validation_errors(self) -> Iterator[str]:
        """Unknown names."""
        wrong = list(model_errors(vehicles, self.model, self.parameters))
        yield from wrong
        if wrong and wrong[0].startswith("model"):
            return
        for line in model_errors(vehicles, self.model, self.parameters | self.true_parameters):
            if line not in wrong:
                yield line.replace("parameters.", "true_parameters.", 1)


class ControlConfig(Strict):
    """Where the control comes from."""

    source: str
    """The log's source."""
    columns: dict[str, str] = {}
    """Component of the control -> column, where they differ."""
    sampling: Sampling = "previous"
    """What a row tells of the time until the next: see the how-to on inertial navigation."""
    counter: Annotated[Finite, Field(gt=1)] | None = None
    """After how many counts a counter of ticks begins anew; 65536 of one with 16 bits."""

    def validation_errors(self) -> Iterator[str]:
        """A counter of what is not counted."""
        if self.counter is not None and self.sampling != "counts":
            yield f'counter: sampling is {self.sampling!r}; this key goes with "counts"'
