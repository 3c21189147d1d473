"""Messages as they arrive: late, twice, overtaken by others."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.simulation.faults import AbstractDeliveryFault
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import fault_key, simulate


class Message(NamedTuple):
    """A reading on its way to whoever estimates as things come."""

    arrival: float  # s
    time: float  # s, its stamp
    sensor: str
    measurement: Any
    target: int


def delivered(scenario: Scenario, key: PRNGKeyArray) -> list[Message]:
    """The readings of :func:`simulate` in the order in which they arrive.

    What was lost as a whole does not. Of several faults of delivery on a sensor the times on
    the way add up, and a copy is on its way as long as what it is a copy of, and longer.
    """
    run, messages = simulate(scenario, key), []
    scenario = dataclasses.replace(scenario, fault_key=fault_key(key))
    for installation, readings in zip(scenario.rig.sensors, run.readings, strict=True):
        times = scenario.times(installation)
        kinds = scenario.drawn_faults(installation)
        delays = [
            np.asarray(t.drawn) for t in kinds if isinstance(t.kind, AbstractDeliveryFault)
        ]
        late = np.sum([delay[:, 0] for delay in delays], axis=0) + np.zeros(len(times))
        read = jax.tree.map(np.asarray, readings.measurement)
        for row, (time, target) in enumerate(zip(times, readings.target, strict=True)):
            one = jax.tree.map(lambda leaf, row=row: leaf[row], read)
            if all(np.isnan(leaf).all() for leaf in jax.tree.leaves(one)):
                continue
            copies = [0.0] + [delay[row, 1] for delay in delays if delay[row, 1] < np.inf]
            for copy in copies:
                arrival = float(time + late[row] + copy)
                messages.append(
                    Message(arrival, float(time), installation.name, one, int(target))
                )
    return sorted(messages, key=lambda message: message.arrival)
