"""A recorded log as the events of an online estimator."""

from collections.abc import Iterator

import jax
import numpy as np

from kedge.estimation.answer import Answer, Event
from kedge.estimation.log import Log
from kedge.estimation.online import Estimator


def replay(estimator: Estimator, log: Log) -> Iterator[Answer]:
    """Push the events of a log in their order; one answer for each.

    The estimator must have been made with the log's first control.
    """
    for event in as_events(log, estimator.sensors):
        time, sensor, measurement, control, target, cov, sequence = event
        yield estimator.push(
            time, sensor, measurement, control=control, target=target, cov=cov,
            sequence=sequence,
        )  # fmt: skip


def as_events(log: Log, sensors: tuple[str, ...]) -> Iterator[Event]:
    """The events of a log in their order; a control comes with the event after which it holds.

    It comes when it changes: that of the first event is not among them.
    """
    time, fired, rows = (np.asarray(part).tolist() for part in log.schedule)
    controls, readings = jax.tree.map(np.asarray, (log.controls, log.readings))
    changes = np.zeros(len(time), bool)
    for leaf in jax.tree.leaves(controls):
        flat = leaf.reshape(len(time), -1)
        changes[:-1] |= (flat[1:] != flat[:-1]).any(axis=1)
    for i, at in enumerate(time):
        control = None
        if changes[i]:
            control = jax.tree.map(lambda leaf, i=i: leaf[i + 1], controls)
        if fired[i] < 0:
            yield Event(at, control=control)
            continue
        one = jax.tree.map(lambda leaf, row=rows[i]: leaf[row], readings[fired[i]])
        name: str = sensors[fired[i]]
        yield Event(at, name, one.measurement, control, int(one.target), one.cov)
