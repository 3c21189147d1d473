"""What a log says of numbers found from it: curvature, standard errors, flat directions."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from kedge.tuning.tunable import Tunable

STEP = 1e-3
"""Of the differences of gradients, in the search's coordinates."""
VAGUE = 0.5
"""A number is identified if the standard error of its logarithm is below this: known, at 95 %,
within a factor of 2.7 either way."""
SHARED = 100.0
"""A number that may be negative is identified if what the others leave open multiplies its
variance by less than this."""


class Curvature(NamedTuple):
    """The loss around its least value, in the coordinates of the search."""

    hessian: Float[np.ndarray, "p p"]
    blocks: Float[np.ndarray, "b p"]
    """Parts of the gradient by stretch of time."""
    free: Bool[np.ndarray, " p"]
    """Which numbers are not at a bound."""
    scale: Float[np.ndarray, " p"]
    """By which a number that may be negative is divided; 1 for logarithms."""

    def inverse(self) -> Float[np.ndarray, "p p"]:
        """The inverse Hessian of the free numbers; what is flat becomes very wide."""
        inverse = np.zeros_like(self.hessian)
        part = np.ix_(self.free, self.free)
        values, vectors = np.linalg.eigh(self.hessian[part])
        floor = 1e-12 * max(np.abs(values).max(initial=0.0), 1e-12)
        inverse[part] = (vectors / np.maximum(values, floor)) @ vectors.T
        return inverse

    def variance(self) -> Float[np.ndarray, " p"]:
        r"""Variance of each coordinate: the larger of two estimates.

        $H^{-1}$ is right if the model is; $H^{-1} J H^{-1}$, with the scores' covariance J from
        their sums over stretches of the log, also if errors are correlated or not Gaussian.

        Source: H. White, "Maximum likelihood estimation of misspecified models", Econometrica
        50(1), 1982.
        """
        inverse = self.inverse()
        spread = self.blocks @ inverse
        return np.maximum(np.diag(inverse), np.sum(spread**2, axis=0))


class Judgement(NamedTuple):
    """What is known of one number."""

    std_error: float
    """Of its logarithm if it was sought by that, else in its unit; NaN at a bound."""
    interval: tuple[float, float]
    """95 %."""
    identified: bool
    verdict: str


def curvature(
    evaluator: Any, point: Float[np.ndarray, " p"], box: Float[np.ndarray, "2 p"]
) -> tuple[Float[np.ndarray, " p"], Curvature]:
    """The curvature at the least loss, to which two Newton steps lead the rest of the way."""
    for remaining in (2, 1, 0):
        minimum = evaluator(point)
        at_low = (point <= box[0] + 1e-6) & (minimum.gradient > 0)
        at_high = (point >= box[1] - 1e-6) & (minimum.gradient < 0)
        free = ~(at_low | at_high)
        hessian = _hessian(evaluator, point)
        shape = Curvature(hessian, minimum.blocks, free, evaluator.scale)
        step = -shape.inverse() @ np.where(free, minimum.gradient, 0.0)
        least = np.linalg.eigvalsh(hessian[np.ix_(free, free)]).min(initial=np.inf)
        decrement = -float(step @ minimum.gradient)
        if remaining == 0 or least <= 0 or decrement < 1e-6:
            break
        stepped = np.clip(point + step, *box)
        if not evaluator(stepped).total < minimum.total:
            break
        point = stepped
    return point, shape


def judge(
    chosen: Sequence[Tunable],
    logarithmic: Bool[np.ndarray, " p"],
    values: Float[np.ndarray, " p"],
    shape: Curvature,
) -> tuple[tuple[Judgement, ...], tuple[str, ...]]:
    """A verdict on each number, and the directions about which the log says next to nothing."""
    unit = _units(shape, logarithmic)
    inverse = np.diag(shape.inverse()) / unit**2
    errors = np.sqrt(shape.variance())
    flat = _flat(shape, unit)
    judgements = []
    for i, tunable in enumerate(chosen):
        if not shape.free[i]:
            side = "lower" if shape.blocks[:, i].sum() > 0 else "upper"
            judgements.append(
                Judgement(np.nan, (np.nan, np.nan), False, f"no: at its {side} bound")
            )
            continue
        width = max(np.sqrt(inverse[i]), errors[i] if logarithmic[i] else 0.0)
        clear = bool(width <= VAGUE)
        error = float(errors[i] * (1.0 if logarithmic[i] else shape.scale[i]))
        ends = values[i] + 1.96 * error * np.array([-1.0, 1.0])
        if logarithmic[i]:
            ends = values[i] * np.exp(np.clip(1.96 * error, 0.0, 700.0) * np.array([-1.0, 1.0]))
        verdict = "yes"
        if not clear:
            mates = sorted(
                {chosen[j].key for mix in flat if abs(mix[i]) > 0.2 for j in _members(mix)}
                - {tunable.key}
            )
            verdict = f"no: only together with {', '.join(mates)}" if mates else "no: too flat"
        judgements.append(Judgement(error, (float(ends[0]), float(ends[1])), clear, verdict))
    return tuple(judgements), tuple(_sentence(chosen, mix) for mix in flat)


def profile(
    evaluator: Any,
    chosen: Sequence[Tunable],
    point: Float[np.ndarray, " p"],
    shape: Curvature,
    judgements: Sequence[Judgement],
    box: Float[np.ndarray, "2 p"],
    count: int = 9,
) -> dict[str, tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]]:
    r"""Twice the rise of the loss along each number that is known, over three standard errors.

    The others follow to where they are best by the curvature, $-H_{oo}^{-1} H_{oj}\,\delta$,
    so that the curve is the profile likelihood to second order, and never below it.
    """
    profiles, least = {}, evaluator(point).total
    inverse = shape.inverse()
    for i, (tunable, judgement) in enumerate(zip(chosen, judgements, strict=True)):
        if not judgement.identified:
            continue
        reach = 3 * np.sqrt(inverse[i, i])
        # The column of the inverse is the direction in which all move together.
        way = inverse[:, i] / inverse[i, i]
        shares = reach * np.linspace(-1, 1, count)
        points = [np.clip(point + share * way, *box) for share in shares]
        rises = [2 * (evaluator(shifted).total - least) for shifted in points]
        values = [evaluator.values(shifted)[i] for shifted in points]
        profiles[tunable.key] = np.array(values), np.array(rises)
    return profiles


def _hessian(evaluator: Any, point: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p p"]:
    """Central differences of the gradient, symmetrised."""
    rows = []
    for step in STEP * np.eye(len(point)):
        rows.append(evaluator(point + step).gradient - evaluator(point - step).gradient)
    hessian = np.array(rows) / (2 * STEP)
    return (hessian + hessian.T) / 2


def _units(shape: Curvature, logarithmic: Bool[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    """By what coordinates are divided so that one bound on the error serves all of them."""
    diagonal = np.diag(shape.hessian)
    natural = np.sqrt(SHARED) / VAGUE / np.sqrt(np.maximum(diagonal, 1e-300))
    return np.where(logarithmic | (diagonal <= 0), 1.0, natural)


def _flat(shape: Curvature, unit: Float[np.ndarray, " p"]) -> list[Float[np.ndarray, " p"]]:
    """Directions, of length 1 in these units, in which the loss is flat or falls."""
    kept = np.flatnonzero(shape.free)
    if len(kept) == 0:
        return []
    values, vectors = np.linalg.eigh((shape.hessian * np.outer(unit, unit))[np.ix_(kept, kept)])
    directions = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value < 1 / VAGUE**2:
            whole = np.zeros(len(shape.free))
            whole[kept] = vector * np.sign(vector[np.argmax(np.abs(vector))])
            directions.append(whole)
    return directions


def _members(mix: Float[np.ndarray, " p"]) -> list[int]:
    return np.flatnonzero(np.abs(mix) > 0.2).tolist()


def _sentence(chosen: Sequence[Tunable], mix: Float[np.ndarray, " p"]) -> str:
    up = [chosen[j].key for j in _members(mix) if mix[j] > 0]
    down = [chosen[j].key for j in _members(mix) if mix[j] < 0]
    if not down and len(up) == 1:
        return f"{up[0]}: the log hardly depends on it"
    if not down:
        return f"{', '.join(up)}: the log hardly changes if they grow together"
    return f"the log hardly changes if {', '.join(up)} grow and {', '.join(down)} shrink"
