"""A recorded log pushed through an online estimator, event by event."""

from collections.abc import Iterator

import jax
import numpy as np

from kedge.estimation.answer import Answer
from kedge.estimation.log import Log
from kedge.estimation.online import Estimator


def replay(estimator: Estimator, log: Log) -> Iterator[Answer]:
    """Push the events of a log in their order; one answer for each.

    The estimator must have been made with the log's first control. A control is told when it
    changes.
    """
    time, fired, rows = (np.asarray(part).tolist() for part in log.schedule)
    controls, readings = jax.tree.map(np.asarray, (log.controls, log.readings))
    for i in range(len(time)):
        now, then = (
            jax.tree.map(lambda leaf, at=at: leaf[at], controls)
            for at in (i, min(i + 1, len(time) - 1))
        )
        pairs = zip(jax.tree.leaves(now), jax.tree.leaves(then), strict=True)
        control = None if all(np.array_equal(a, b) for a, b in pairs) else then
        if fired[i] < 0:
            yield estimator.push(time[i], control=control)
            continue
        one = jax.tree.map(lambda leaf, at=rows[i]: leaf[at], readings[fired[i]])
        yield estimator.push(
            time[i],
            estimator.sensors[fired[i]],
            one.measurement,
            control=control,
            target=int(one.target),
            cov=one.cov,
        )
