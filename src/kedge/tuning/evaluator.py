"""A loss as a function of numbers of a rig, with its gradient: one compiled program for all."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError, DataError
from kedge.estimation.log import Log, Recording
from kedge.estimation.rig import Rig, as_arrays
from kedge.tuning.log import arranged, timeline
from kedge.tuning.loss import Known, Losses, Tails
from kedge.tuning.tunable import Tunable, placed

BLOCKS = 30
"""Stretches of the log over which scores are summed: what is correlated lies within one."""
WORST = 1e6
"""Loss by judgement, beyond that of the start, of what cannot be judged."""


class Evaluation(NamedTuple):
    """The loss at a point of the search."""

    total: float
    gradient: Float[np.ndarray, " p"]
    blocks: Float[np.ndarray, "b p"]
    """The gradient's parts by stretch of time."""
    fused: int
    judged: int


class Evaluator:
    """The loss and its gradient as a function of the coordinates of the search.

    Coordinates are logarithms of what is above 0; of other numbers multiples of ``scale``,
    which is about as far as the log lets them be known.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        tails: Tails,
        recording: Recording,
        known: Known | None,
        chosen: tuple[Tunable, ...],
        high: Float[np.ndarray, " p"],
        until: float | int,
    ):
        sensors = len(rig.sensors)
        # Without their values, so that other starts compile nothing anew.
        self.places = tuple(t._replace(value=0.0) for t in chosen)
        self.rig = as_arrays(rig)
        self.logarithmic = np.array([t.is_logarithmic for t in chosen])
        self.scale = np.ones(len(chosen))
        self.base = np.array([t.value for t in chosen])
        self.moving = {
            t.latency_of: i for i, t in enumerate(chosen) if t.latency_of is not None
        }
        earlier = np.zeros(sensors)
        for sensor, index in self.moving.items():
            earlier[sensor] = max(high[index] - self.base[index], 0.0)
        self.line = timeline(recording, until, earlier)
        outputs = int(self.line.is_output.sum())
        if known is not None:
            # Outputs keep their order, whatever moves between them.
            known = known._replace(
                events=known.events[:outputs],
                there=known.there[:outputs],
                fields={name: v[:outputs] for name, v in known.fields.items()},
            )
            if not known.there.any():
                raise DataError("truth covers none of the output times that are tuned on")
        self.losses = Losses(as_arrays(filter), tails, known)
        self.judged, self.fused = 0, -1
        self._kept: tuple[Log, Losses] | None = None

    def begin(self, start: Evaluation) -> None:
        """Take the first evaluation as what all others are compared with.

        Raises:
            ContractError: it cannot be used.
        """
        if start.fused == 0:
            raise ContractError("tune: the filter fused no reading; there is nothing to judge")
        if not (np.isfinite(start.total) and np.isfinite(start.gradient).all()):
            raise ContractError(
                f"tune: the loss is {start.total:g} at the start and its derivative "
                f"{start.gradient.tolist()}; expected finite numbers: start from other values, "
                "or use the filter 'extended'"
            )
        self.fused, self.judged = start.fused, start.judged
        self.ceiling = start.total + WORST * self.judged
        steep = np.sqrt(np.sum(start.blocks**2, axis=0))
        self.scale = np.where(
            self.logarithmic | (steep == 0), 1.0, 1 / np.maximum(steep, 1e-12)
        )

    def __call__(self, point: Float[np.ndarray, " p"]) -> Evaluation:
        """Loss and gradient; the ceiling, level, where other readings are fused."""
        values = self.values(point)
        log, losses = self._at(values)
        total, gradient, blocks, fused, judged = jax.tree.map(
            np.asarray,
            _evaluate(
                losses, self.rig, log, jnp.asarray(values), jnp.asarray(self.base), self.places
            ),
        )
        by_coordinate = np.where(self.logarithmic, values, self.scale)
        evaluation = Evaluation(
            float(total),
            gradient * by_coordinate,
            blocks * by_coordinate[None],
            int(fused),
            int(judged),
        )
        good = np.isfinite(total) and np.isfinite(gradient).all()
        if self.fused >= 0 and not (good and int(fused) == self.fused):
            nothing = np.zeros_like(evaluation.gradient)
            return evaluation._replace(total=self.ceiling, gradient=nothing)
        return evaluation

    def _at(self, values: Float[np.ndarray, " p"]) -> tuple[Log, Losses]:
        """The log in the order that these latencies give it, and its losses."""
        kept = self._kept
        if kept is None or self.moving:
            later = np.zeros(len(self.rig.sensors))
            for sensor, index in self.moving.items():
                later[sensor] = values[index] - self.base[index]
            order, losses = arranged(self.line, later), self.losses
            if losses.known is not None:
                known = losses.known._replace(events=order.outputs)
                losses = Losses(losses.filter, losses.tails, known)
            kept = self._kept = as_arrays((order.log, losses))
        return kept

    def values(self, point: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """The numbers at a point."""
        raised = np.exp(np.where(self.logarithmic, point, 0.0))
        return np.where(self.logarithmic, raised, self.base + self.scale * point)

    def coordinates(self, values: Sequence[float] | np.ndarray) -> Float[np.ndarray, " p"]:
        """The point at which the numbers are these."""
        values = np.asarray(values, float)
        logs = np.log(np.where(self.logarithmic, values, 1.0))
        return np.where(self.logarithmic, logs, (values - self.base) / self.scale)


@eqx.filter_jit
def _evaluate(
    losses: Losses,
    rig: Rig,
    log: Log,
    values: Float[Array, " p"],
    base: Float[Array, " p"],
    places: tuple[Tunable, ...],
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum of the losses, its gradient, that by block, readings fused, losses counted."""

    def of(values: Float[Array, " p"]):
        time = log.schedule.time
        for index, tunable in enumerate(places):
            if tunable.latency_of is not None:
                mine = log.schedule.sensor == tunable.latency_of
                time = time - jnp.where(mine, values[index] - base[index], 0.0)
        shifted = log._replace(schedule=log.schedule._replace(time=time))
        terms, fused = losses(placed(rig, places, values), shifted)
        return terms, (terms, fused)

    jacobian, (terms, fused) = jax.jacfwd(of, has_aux=True)(values)
    block = jnp.arange(len(terms)) * BLOCKS // len(terms)
    blocks = jax.ops.segment_sum(jacobian, block, BLOCKS)
    judged = fused if losses.known is None else jnp.sum(losses.known.there)
    return jnp.sum(terms), jnp.sum(jacobian, axis=0), blocks, fused, judged
