"""Noise, scales and latencies of a rig from logs, by gradient through the filter."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kedge.core.contracts import AbstractFilter, AbstractGaussianFilter
from kedge.core.errors import ConfigError, ContractError
from kedge.estimation.rig import Rig
from kedge.filters.wrappers.gated import Gated
from kedge.filters.wrappers.wrapper import AbstractWrapper
from kedge.tuning.curvature import Curvature, Judgement, curvature, judge, profile
from kedge.tuning.evaluator import Case, Evaluator
from kedge.tuning.loss import ungated
from kedge.tuning.tunable import Tunable, placed

LATENCY_SPAN = 0.2  # s


class Search(NamedTuple):
    """How to look for the least loss."""

    starts: int = 4
    span: float = 1000.0
    """Each number above 0 stays within this factor of its start."""
    bounds: Mapping[str, tuple[float, float]] = {}
    """Others, by key."""
    seed: int = 0
    iterations: int = 100


class Attempt(NamedTuple):
    """Where one start led."""

    loss: float
    """By reading, or by output time; infinite if the filter cannot run there."""
    point: Float[np.ndarray, " p"]
    evaluations: int


class Tuned(NamedTuple):
    """What was found, and what the log says of it."""

    chosen: tuple[Tunable, ...]
    values: Float[np.ndarray, " p"]
    judgements: tuple[Judgement, ...]
    flat: tuple[str, ...]
    """Directions about which the log says next to nothing."""
    loss_before: float
    loss_after: float
    judged: int
    """How many readings or output times were judged."""
    attempts: tuple[Attempt, ...]
    curvature: Curvature
    profiles: dict[str, tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]]
    """By key: values, and twice the rise of the whole loss there."""
    notes: tuple[str, ...]

    @property
    def agreed(self) -> int:
        """How many starts led to the same least loss."""
        least = min(attempt.loss for attempt in self.attempts)
        return sum((a.loss - least) * self.judged < 0.5 for a in self.attempts)

    def rig(self, rig: Rig) -> Rig:
        """A rig with the values found; latencies belong to logs."""
        return placed(rig, self.chosen, jnp.asarray(self.values))


class Fit(NamedTuple):
    """Where a search led, without what is known of it."""

    evaluator: Evaluator
    chosen: tuple[Tunable, ...]
    box: Float[np.ndarray, "2 p"]
    loss_before: float
    attempts: tuple[Attempt, ...]
    notes: tuple[str, ...]

    @property
    def best(self) -> Attempt:
        """The attempt of the least loss."""
        return min(self.attempts, key=lambda attempt: attempt.loss)

    @property
    def values(self) -> Float[np.ndarray, " p"]:
        """The numbers that it found."""
        return self.evaluator.values(self.best.point)


def tune(
    filter: AbstractFilter,
    cases: Sequence[Case],
    chosen: Sequence[Tunable],
    search: Search | None = None,
    horizons: Sequence[float] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Tuned:
    r"""Find the values under which logs are least surprising, and judge them.

    Without truth the innovations are judged, with it the errors of the estimate: see
    :func:`~kedge.tuning.loss.innovation_losses` and ``truth_losses``; with ``horizons``, in s,
    the readings as predicted over each of them
    (:class:`~kedge.tuning.loss.Losses`). A number above
    0 is sought by its logarithm, another on its own scale, by L-BFGS within bounds from several
    starts, with derivatives carried forward through the filter.

    Raises:
        ContractError: the filter has no derivative in its noise, or fuses nothing.
        ConfigError: a number has no start from which it can be tuned, or bad bounds.
        DataError: nothing of the logs is there to judge, or one is too short for a horizon.

    Source: R. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE
    Transactions on Automatic Control 15(2), 1970; R. Byrd, P. Lu, J. Nocedal, C. Zhu, "A
    limited memory algorithm for bound constrained optimization", SIAM Journal on Scientific
    Computing 16(5), 1995.
    """
    return conclude(fit(filter, cases, chosen, search, horizons, progress))


def fit(
    filter: AbstractFilter,
    cases: Sequence[Case],
    chosen: Sequence[Tunable],
    search: Search | None = None,
    horizons: Sequence[float] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Fit:
    """The search alone.

    Raises:
        KedgeError: as :func:`tune`.
    """
    search = search or Search()
    if horizons and any(case.truth is not None for case in cases):
        raise ConfigError("horizons: readings are judged over them, and truth is not; choose")
    notes = ungated(cases[0].rig)[2]
    filter = _differentiable(filter, notes)
    low, high = _bounds(chosen, search)
    evaluator = Evaluator(filter, cases, tuple(chosen), high, horizons)
    first = evaluator.coordinates([t.value for t in chosen])
    start = evaluator(first)
    evaluator.begin(start)
    progress(f"tuning {len(chosen)} numbers on {evaluator.judged} judgements")

    box = np.sort([evaluator.coordinates(low), evaluator.coordinates(high)], axis=0)
    attempts = []
    for number, begin in enumerate(_starts(evaluator, first, box, search), start=1):
        attempts.append(_descend(evaluator, begin, box, search.iterations))
        progress(f"start {number} of {search.starts}: {attempts[-1].loss:.6g} by judgement")
    before = start.total / evaluator.judged
    return Fit(evaluator, tuple(chosen), box, before, tuple(attempts), tuple(notes))


def conclude(found: Fit) -> Tuned:
    """The last steps to the least loss, and what the logs say of each number there."""
    evaluator, chosen = found.evaluator, found.chosen
    point, shape = curvature(evaluator, found.best.point, found.box)
    final = evaluator(point)
    values = evaluator.values(point)
    judgements, flat = judge(chosen, evaluator.logarithmic, values, shape)
    return Tuned(
        chosen=chosen,
        values=values,
        judgements=judgements,
        flat=flat,
        loss_before=found.loss_before,
        loss_after=final.total / evaluator.judged,
        judged=evaluator.judged,
        attempts=found.attempts,
        curvature=shape,
        profiles=profile(evaluator, chosen, point, shape, judgements, found.box),
        notes=found.notes,
    )


def _descend(
    evaluator: Evaluator,
    begin: Float[np.ndarray, " p"],
    box: Float[np.ndarray, "2 p"],
    iterations: int,
) -> Attempt:
    from scipy.optimize import minimize

    evaluations = 0
    least, best = np.inf, begin

    def by_judgement(point: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal evaluations, least, best
        evaluations += 1
        minimum = evaluator(point)
        if minimum.total < least:
            least, best = minimum.total, point.copy()
        return minimum.total / evaluator.judged, minimum.gradient / evaluator.judged

    if by_judgement(begin)[0] * evaluator.judged >= evaluator.ceiling:
        return Attempt(np.inf, begin, evaluations)
    minimize(
        by_judgement, begin, jac=True, method="L-BFGS-B", bounds=box.T,
        options={"maxiter": iterations, "ftol": 1e-12, "gtol": 1e-6 / evaluator.judged},
    )  # fmt: skip
    # A search that runs into a wall may stop on the wrong side of it.
    return Attempt(least / evaluator.judged, best, evaluations)


def _starts(
    evaluator: Evaluator,
    first: Float[np.ndarray, " p"],
    box: Float[np.ndarray, "2 p"],
    search: Search,
) -> list[Float[np.ndarray, " p"]]:
    """The rig's own values, then others up to ten times away."""
    random = np.random.default_rng(search.seed)
    reach = np.where(evaluator.logarithmic, np.log(10.0), 3.0)
    points = [np.clip(first, *box)]
    for _ in range(search.starts - 1):
        step = random.uniform(-reach, reach)
        points.append(np.clip(first + step, *box))
    return points


def _bounds(
    chosen: Sequence[Tunable], search: Search
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    if search.starts < 1:
        raise ConfigError(f"starts: found {search.starts}, expected at least 1")
    if not 1 < search.span < np.inf:
        raise ConfigError(f"span: found {search.span:g}, expected a factor above 1")
    keys = [t.key for t in chosen]
    if others := [key for key in search.bounds if key not in keys]:
        raise ConfigError(f"bounds: {others[0]} is not tuned; tuned are {', '.join(keys)}")
    low, high = [], []
    for t in chosen:
        if t.is_noise and not t.value > 0:
            raise ConfigError(
                f"{t.key}: found {t.value:g}, expected a start above 0, since noise is tuned "
                f"by its logarithm: give it one with --set {t.key}=..."
            )
        ends = (-np.inf, np.inf)
        if t.latency_of is not None:
            ends = (t.value - LATENCY_SPAN, t.value + LATENCY_SPAN)
        elif t.is_logarithmic:
            ends = (t.value / search.span, t.value * search.span)
        ends = search.bounds.get(t.key, ends)
        if not ends[0] <= t.value <= ends[1] or ends[0] == ends[1]:
            raise ConfigError(
                f"{t.key}: found bounds {ends[0]:g} to {ends[1]:g}, expected the start "
                f"{t.value:g} between them"
            )
        if t.is_logarithmic and not ends[0] > 0:
            raise ConfigError(f"{t.key}: found the bound {ends[0]:g}, expected one above 0")
        low.append(ends[0])
        high.append(ends[1])
    return np.array(low), np.array(high)


def _differentiable(filter: AbstractFilter, notes: list[str]) -> AbstractFilter:
    """The filter without a gate of its own."""
    if isinstance(filter, AbstractWrapper) and isinstance(filter, Gated):
        notes.append("the filter's own gate was left out: it would make the likelihood jump")
        return _differentiable(filter.inner, notes)
    inner = _innermost(filter)
    if not isinstance(inner, AbstractGaussianFilter):
        raise ContractError(
            f"tune: {type(inner).__name__} carries no Gaussian, so its likelihood has no "
            "derivative to follow; use for example 'extended' or 'unscented'"
        )
    return filter


def _innermost(filter: AbstractFilter) -> AbstractFilter:
    while isinstance(filter, AbstractWrapper):
        filter = filter.inner
    return filter
