"""Scenarios: a rig on its default drive, for so long, in such steps."""

import equinox as eqx
import numpy as np

from kedge.core.errors import ContractError
from kedge.estimation.rig import Installation, Rig


class Scenario(eqx.Module):
    """A rig driven by its vehicle's own ``drive``; sensors fire at their rates.

    A sensor over a map sees its targets in turn, one each time it fires.
    """

    rig: Rig
    duration: float = eqx.field(static=True, default=60.0)  # s
    dt: float = eqx.field(static=True, default=0.1)  # s, the step of the truth

    def __check_init__(self):
        if not (self.dt > 0 and self.duration >= self.dt):
            raise ContractError(
                f"scenario: duration {self.duration:g} s and dt {self.dt:g} s; expected "
                "0 < dt <= duration"
            )

    @property
    def steps(self) -> int:
        """How many steps the truth takes."""
        return round(self.duration / self.dt)

    def ticks(self, installation: Installation) -> np.ndarray:
        """The steps, counted from 1, at whose ends a sensor fires."""
        rate = installation.rate or installation.sensor.nominal_rate
        every = max(1, round(1 / (rate * self.dt)))
        return np.arange(every, self.steps + 1, every)
