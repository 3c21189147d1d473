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
from kedge.estimation.log import Log, Recording, Truth
from kedge.estimation.rig import Rig, as_arrays
from kedge.tuning.log import Timeline, arranged, timeline
from kedge.tuning.loss import Losses, known_truth, ungated
from kedge.tuning.tunable import Tunable, placed

BLOCKS = 30
"""Stretches of the log over which scores are summed: what is correlated lies within one."""
WORST = 1e6
"""Loss by judgement, beyond that of the start, of what cannot be judged."""
FEW, LOST = 0.01, 10.0
"""The share of the readings fused that may change, and the loss of one that no longer is: that
of a reading 4.5 standard deviations away."""


class Evaluation(NamedTuple):
    """The loss at a point of the search."""

    total: float
    gradient: Float[np.ndarray, " p"]
    blocks: Float[np.ndarray, "b p"]
    """The gradient's parts by stretch of time."""
    fused: int
    judged: int


class Case(NamedTuple):
    """A log that is judged, and the rig on it."""

    rig: Rig
    recording: Recording
    truth: Truth | None = None
    """Given, it is what is judged; else the readings."""
    until: float | int = np.inf
    """s; the log ends there."""
    left_out: tuple[float, float] = (np.inf, np.inf)
    """From when on and up to when, in s, nothing is judged."""


class Judged(NamedTuple):
    """A case made ready."""

    rig: Rig
    line: Timeline
    losses: Losses
    left_out: Float[np.ndarray, "2"]


class Evaluator:
    """The loss and its gradient as a function of the coordinates of the search.

    Coordinates are logarithms of what is above 0; of other numbers multiples of ``scale``,
    which is about as far as the logs let them be known.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        cases: Sequence[Case],
        chosen: tuple[Tunable, ...],
        high: Float[np.ndarray, " p"],
        horizons: Sequence[float] = (),
    ):
        # Without their values, so that other starts compile nothing anew.
        self.places = tuple(t._replace(value=0.0) for t in chosen)
        self.logarithmic = np.array([t.is_logarithmic for t in chosen])
        self.scale = np.ones(len(chosen))
        self.base = np.array([t.value for t in chosen])
        self.moving = {
            t.latency_of: i for i, t in enumerate(chosen) if t.latency_of is not None
        }
        earlier = np.zeros(len(cases[0].rig.sensors))
        for sensor, index in self.moving.items():
            earlier[sensor] = max(high[index] - self.base[index], 0.0)
        self.cases = [_judged(filter, case, earlier, horizons) for case in cases]
        self.judged, self.fused = 0, -1
        self._kept: dict[int, tuple[Log, Losses]] = {}

    def begin(self, start: Evaluation) -> None:
        """Take the first evaluation as what all others are compared with.

        Raises:
            ContractError: it cannot be used.
            DataError: it judges nothing.
        """
        if start.fused == 0:
            raise ContractError("tune: the filter fused no reading; there is nothing to judge")
        if start.judged == 0:
            raise DataError("tune: no reading is left to judge: none is held back")
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
        """Loss and gradient; the ceiling, level, where many other readings are fused.

        A sensor may call a reading impossible by what is believed: a few such are charged.
        """
        values = self.values(point)
        parts = [
            _evaluate(
                losses, case.rig, log, jnp.asarray(values), jnp.asarray(self.base), self.places,
                jnp.asarray(case.left_out),
            )
            for case, (log, losses) in (
                (case, self._at(values, number)) for number, case in enumerate(self.cases)
            )
        ]  # fmt: skip
        totals, gradients, by_block, fusions, judgements = zip(
            *jax.tree.map(np.asarray, parts), strict=True
        )
        total, gradient, fused = sum(totals), sum(gradients), sum(fusions)
        blocks, judged = np.concatenate(by_block), sum(judgements)
        by_coordinate = np.where(self.logarithmic, values, self.scale)
        evaluation = Evaluation(
            float(total),
            gradient * by_coordinate,
            blocks * by_coordinate[None],
            int(fused),
            int(judged),
        )
        if self.fused < 0:
            return evaluation
        good = np.isfinite(total) and np.isfinite(gradient).all()
        changed = abs(int(fused) - self.fused)
        if good and changed <= FEW * self.fused:
            lost = self.judged - evaluation.judged
            return evaluation._replace(total=evaluation.total + LOST * lost)
        nothing = np.zeros_like(evaluation.gradient)
        return evaluation._replace(total=self.ceiling, gradient=nothing)

    def _at(self, values: Float[np.ndarray, " p"], number: int) -> tuple[Log, Losses]:
        """A log in the order that these latencies give it, and its losses."""
        kept = self._kept.get(number)
        if kept is None or self.moving:
            case = self.cases[number]
            later, losses = np.zeros(len(case.rig.sensors)), case.losses
            for sensor, index in self.moving.items():
                later[sensor] = values[index] - self.base[index]
            order = arranged(case.line, later)
            if losses.known is not None:
                known = losses.known._replace(events=order.outputs)
                losses = Losses(losses.filter, losses.tails, known, losses.horizons)
            kept = self._kept[number] = as_arrays((order.log, losses))
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


def _judged(
    filter: AbstractFilter,
    case: Case,
    earlier: Float[np.ndarray, " s"],
    horizons: Sequence[float],
) -> Judged:
    """A case made ready.

    Raises:
        DataError: nothing of the log is there to judge, or it is too short for a horizon.
    """
    rig, tails, _ = ungated(case.rig)
    line = timeline(case.recording, case.until, earlier)
    known = None
    if case.truth is not None:
        known = known_truth(case.recording, case.truth, rig.prior.mean)
        outputs = int(line.is_output.sum())
        # Outputs keep their order, whatever moves between them.
        known = known._replace(
            events=known.events[:outputs],
            there=known.there[:outputs],
            fields={name: v[:outputs] for name, v in known.fields.items()},
        )
        if not known.there.any():
            raise DataError("truth covers none of the output times that are tuned on")
    for horizon in horizons:
        if not 0 < horizon <= line.time[-1] / 2:
            raise DataError(
                f"horizons: found {horizon:g} s, expected above 0 and at most half of the "
                f"{line.time[-1]:.4g} s of log that are tuned on"
            )
    losses = Losses(as_arrays(filter), tails, known, np.asarray(horizons, float))
    return Judged(as_arrays(rig), line, losses, np.asarray(case.left_out))


@eqx.filter_jit
def _evaluate(
    losses: Losses,
    rig: Rig,
    log: Log,
    values: Float[Array, " p"],
    base: Float[Array, " p"],
    places: tuple[Tunable, ...],
    left_out: Float[Array, "2"],
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum of the losses, its gradient, that by block, readings fused, losses counted."""
    recorded = log.schedule.time

    def of(values: Float[Array, " p"]):
        time = recorded
        for index, tunable in enumerate(places):
            if tunable.latency_of is not None:
                mine = log.schedule.sensor == tunable.latency_of
                time = time - jnp.where(mine, values[index] - base[index], 0.0)
        shifted = log._replace(schedule=log.schedule._replace(time=time))
        terms, judged, fused = losses(placed(rig, places, values), shifted)
        at = recorded if losses.known is None else recorded[losses.known.events]
        counts = (at < left_out[0]) | (at >= left_out[1])
        terms, judged = jnp.where(counts, terms, 0.0), jnp.where(counts, judged, 0)
        return terms, (terms, jnp.sum(judged), fused)

    jacobian, (terms, judged, fused) = jax.jacfwd(of, has_aux=True)(values)
    block = jnp.arange(len(terms)) * BLOCKS // len(terms)
    blocks = jax.ops.segment_sum(jacobian, block, BLOCKS)
    return jnp.sum(terms), jnp.sum(jacobian, axis=0), blocks, fused, judged
