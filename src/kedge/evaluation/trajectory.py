"""Accuracy of a trajectory against truth: association, alignment, pose errors.

The figures are those of the programs ``evo_ape`` and ``evo_rpe`` (pose relations ``trans_part``
and ``angle_rad``), so that anyone can check them with a second tool. Planar poses are computed
as spatial ones that turn about the vertical only.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation, Slerp

from kedge.core.errors import ConfigError, DataError, UnknownName


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the body in the map, in the order of time.

    A planar one carries headings in rad, a spatial one unit quaternions (w, x, y, z) from body
    to map; either may carry no orientation.

    Raises:
        DataError: the parts do not fit together, or a value is not finite.
    """

    time: Float[np.ndarray, " T"]  # s
    position: Float[np.ndarray, "T d"]  # m
    orientation: Float[np.ndarray, " T"] | Float[np.ndarray, "T 4"] | None = None

    def __post_init__(self) -> None:
        for name in ("time", "position", "orientation"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, value := np.asarray(value, dtype=np.float64))
                if bad := np.count_nonzero(~np.isfinite(value)):
                    raise DataError(f"{name}: {bad} values are not finite; leave them out")
        count, where, turns = self.time.size, self.position.shape, self.orientation
        if self.time.shape != (count,) or where not in ((count, 2), (count, 3)):
            raise DataError(f"position: found {where}, expected ({count}, 2) or ({count}, 3)")
        if turns is not None and turns.shape != (fits := ((count,), (count, 4))[where[1] - 2]):
            raise DataError(f"orientation: found {turns.shape}, expected {fits}")
        if turns is not None and turns.ndim == 2 and np.any(abs((turns**2).sum(1) - 1) > 0.02):
            raise DataError("orientation: found quaternions that are not of unit length")
        if np.any(back := np.diff(self.time) < 0):
            raise DataError(f"time runs backwards after {self.time[np.argmax(back)]:.9f} s")

    def take(self, chosen: Bool[np.ndarray, " T"]) -> "Trajectory":
        """Keep the poses that a mask selects."""
        turns = None if self.orientation is None else self.orientation[chosen]
        return Trajectory(self.time[chosen], self.position[chosen], turns)

    def to_plane(self) -> "Trajectory":
        """Drop the height; of the attitude, keep the heading of the body's first axis."""
        return Trajectory(self.time, self.position[:, :2], _oriented(_rotations(self), 2))


class Motion(NamedTuple):
    """A map of points ``x -> scale * rotation @ x + translation``."""

    rotation: Float[np.ndarray, "d d"]
    translation: Float[np.ndarray, " d"]
    scale: float = 1.0

    def apply(self, trajectory: Trajectory) -> Trajectory:
        """Move the positions, turn the orientations."""
        size, turn, turns = len(self.rotation), np.eye(3), _rotations(trajectory)
        turn[:size, :size] = self.rotation
        turns = None if turns is None else Rotation.from_matrix(turn) * turns
        position = self.points(trajectory.position)
        return Trajectory(trajectory.time, position, _oriented(turns, size))

    def points(self, points: Float[np.ndarray, "T d"]) -> Float[np.ndarray, "T d"]:
        """Move points."""
        return self.scale * points @ self.rotation.T + self.translation[None]


def associate(
    estimate: Trajectory, truth: Trajectory, max_gap: float | int
) -> tuple[Trajectory, Trajectory]:
    """Interpolate truth at the estimate's stamps; leave out stamps that truth does not cover.

    Positions go straight, headings and quaternions along the shortest arc, at constant speed.
    Covered are the stamps of truth, and those in gaps of at most ``max_gap`` s between them.

    Raises:
        DataError: no stamp is covered, or truth has fewer than two poses or repeats a stamp.

    Source: K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985.
    """
    if truth.position.shape[1] != estimate.position.shape[1]:
        raise DataError("one trajectory is planar, the other is not; use to_plane() on that")
    if truth.time.size < 2 or np.any(np.diff(truth.time) == 0):
        raise DataError("truth needs two poses or more, and no two at the same time")
    right = np.searchsorted(truth.time, estimate.time).clip(1, truth.time.size - 1)
    before, after, time = truth.time[right - 1], truth.time[right], estimate.time
    # Stamps are whole nanoseconds; less is rounding, which must not decide.
    between = (before < time) & (time < after) & (after - before <= max_gap + 1e-9)
    chosen = estimate.take(between | (time == before) | (time == after))
    if not (time := chosen.time).size:
        raise DataError(f"truth, {truth.time[0]:g} to {truth.time[-1]:g} s, covers no estimate")
    position = np.stack([np.interp(time, truth.time, x) for x in truth.position.T], axis=1)
    turns = _rotations(truth)
    turns = None if turns is None else Slerp(truth.time, turns)(time)
    return chosen, Trajectory(time, position, _oriented(turns, position.shape[1]))


def align(estimate: Trajectory, truth: Trajectory, kind: str = "none") -> Trajectory:
    """Move an estimate onto truth at the same stamps.

    ``none``; ``origin``: onto the first pose (without orientations: the first position);
    ``rigid``, ``similarity``: :func:`umeyama` over all positions. In the plane the motion is
    planar, so it never turns the plane over, as a spatial one might.

    Raises:
        DataError: the stamps differ, or the positions do not determine the motion.
        UnknownName: there is no such kind.
    """
    _require_same_stamps(estimate, truth)
    if kind == "none":
        return estimate
    if kind in ("rigid", "similarity"):
        return umeyama(estimate.position, truth.position, kind == "similarity").apply(estimate)
    if kind != "origin":
        raise UnknownName(f"no alignment {kind!r}; there are none, origin, rigid, similarity")
    size, turns, goal = estimate.position.shape[1], _rotations(estimate), _rotations(truth)
    turn = np.eye(size)
    if turns is not None and goal is not None:
        turn = (goal[0] * turns[0].inv()).as_matrix()[:size, :size]
    return Motion(turn, truth.position[0] - turn @ estimate.position[0]).apply(estimate)


def umeyama(
    source: Float[np.ndarray, "T d"], target: Float[np.ndarray, "T d"], scaled: bool
) -> Motion:
    r"""Find the rigid motion, or with ``scaled`` the similarity, of points onto points.

    $\min_{s, R, t} \sum_i |y_i - (s R x_i + t)|^2,\quad \det R = 1$

    Raises:
        DataError: all points lie on one spot or, in space, on one line, so that many rotations
            fit equally well.

    Source: S. Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", IEEE Trans. Pattern Analysis and Machine Intelligence 13(4), 1991, section III.
    """
    spread, goal = source - source.mean(0)[None], target - target.mean(0)[None]
    u, stretch, vt = np.linalg.svd(goal.T @ spread / len(source))
    rounding = 4 * np.finfo(float).eps * max(abs(source).max(), abs(target).max())
    if stretch[-2] <= 1e-12 * stretch[0] + rounding**2:
        raise DataError("the positions lie on one spot or one line: they fix no alignment")
    # The last sign keeps R a rotation where a reflection would fit better.
    signs = np.ones_like(stretch)
    signs[-1] = np.sign(np.linalg.det(u @ vt))
    turn = u @ np.diag(signs) @ vt
    scale = float(stretch @ signs / np.mean(np.sum(spread**2, axis=1))) if scaled else 1.0
    return Motion(turn, target.mean(0) - scale * turn @ source.mean(0), scale)


class Statistics(NamedTuple):
    """Summary of errors; ``std`` divides by their count."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


class PoseError(NamedTuple):
    """Errors in m and rad at ``time`` (of a pair: of its later pose), and their summaries."""

    time: Float[np.ndarray, " P"]
    translations: Float[np.ndarray, " P"]
    rotations: Float[np.ndarray, " P"] | None
    translation: Statistics
    rotation: Statistics | None


def absolute_pose_error(estimate: Trajectory, truth: Trajectory) -> PoseError:
    r"""Compare poses with truth at the same stamps, as ``evo_ape``: align first if so wished.

    $|\hat p_i - p_i|$, and the angle of $R_i^T \hat R_i$ where both have orientations

    Raises:
        DataError: the stamps differ.

    Source: Z. Zhang and D. Scaramuzza, "A tutorial on quantitative trajectory evaluation for
    visual(-inertial) odometry", IROS 2018, absolute trajectory error.
    """
    _require_same_stamps(estimate, truth)
    turns, goal = _rotations(estimate), _rotations(truth)
    angles = None if turns is None or goal is None else (goal.inv() * turns).magnitude()
    return _summed_up(estimate.time, estimate.position - truth.position, angles)


def relative_pose_error(
    estimate: Trajectory,
    truth: Trajectory,
    delta: float | int,
    unit: str = "frames",
    pairs_from: str = "estimate",
) -> PoseError:
    r"""Compare motions with those of truth at the same stamps, as ``evo_rpe``.

    $E_{ij} = (T_i^{-1} T_j)^{-1} (\hat T_i^{-1} \hat T_j)$: its length and its angle

    Over consecutive pairs (j is the next i), the program's default, not over all pairs: j is
    the first pose at least ``delta`` frames, metres along the path, or seconds after i. As the
    program does, measure the path of the estimate; ``pairs_from="truth"`` (its option
    ``--pairs_from_reference``) gives several estimates the same pairs. Without orientations,
    displacements are compared in the map frame.

    Raises:
        DataError: the stamps differ, or no two poses are ``delta`` apart.
        ConfigError: ``delta`` is not positive, or not a whole number of frames.
        UnknownName: there is no such unit, or no such trajectory.

    Source: J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012,
    relative pose error.
    """
    _require_same_stamps(estimate, truth)
    if pairs_from not in ("estimate", "truth"):
        raise UnknownName(f"no pairs from {pairs_from!r}; there are estimate, truth")
    first, last = _pairs(truth if pairs_from == "truth" else estimate, delta, unit)
    moves = [_lifted(t.position[last] - t.position[first]) for t in (estimate, truth)]
    turns, goal, angles = _rotations(estimate), _rotations(truth), None
    if turns is not None and goal is not None:
        moves = [r[first].inv().apply(m) for r, m in zip((turns, goal), moves, strict=True)]
        step, truth_step = turns[first].inv() * turns[last], goal[first].inv() * goal[last]
        angles = (truth_step.inv() * step).magnitude()
    return _summed_up(estimate.time[last], moves[0] - moves[1], angles)


def _pairs(path: Trajectory, delta: float | int, unit: str) -> Int[np.ndarray, "2 P"]:
    steps = {
        "frames": np.ones(path.time.size - 1),
        "metres": np.linalg.norm(np.diff(path.position, axis=0), axis=1),
        "seconds": np.diff(path.time),
    }
    if unit not in steps:
        raise UnknownName(f"no unit {unit!r}; there are {', '.join(steps)}")
    if not delta > 0 or (unit == "frames" and delta != int(delta)):
        raise ConfigError(f"delta: found {delta} {unit}, expected a positive (whole) number")
    # Stamps are whole nanoseconds, so 2 * 0.1 s is 0.2 s; metres round as in the program.
    enough = delta - 1e-9 if unit == "seconds" else delta
    ends, travelled = [0], 0.0
    for index, step in enumerate(steps[unit], start=1):
        if (travelled := travelled + step) >= enough:
            ends.append(index)
            travelled = 0.0
    if len(ends) < 2:
        raise DataError(f"no two poses are {delta:g} {unit} apart")
    return np.stack([ends[:-1], ends[1:]])


def _summed_up(time: np.ndarray, gaps: np.ndarray, angles: np.ndarray | None) -> PoseError:
    def summary(x: np.ndarray) -> Statistics:
        parts = np.sqrt(np.mean(x**2)), x.mean(), np.median(x), x.std(), x.min(), x.max()
        return Statistics(*map(float, parts))

    lengths = np.linalg.norm(gaps, axis=1)
    turn = None if angles is None else summary(angles)
    return PoseError(time, lengths, angles, summary(lengths), turn)


def _require_same_stamps(estimate: Trajectory, truth: Trajectory) -> None:
    same = estimate.position.shape == truth.position.shape
    if not (same and estimate.time.size and np.array_equal(estimate.time, truth.time)):
        raise DataError("estimate and truth differ in stamps or size: associate() them first")


def _rotations(trajectory: Trajectory) -> Rotation | None:
    turns = trajectory.orientation
    if turns is None:
        return None
    if turns.ndim == 1:
        return Rotation.from_euler("z", turns[:, None])
    return Rotation.from_quat(turns[:, [1, 2, 3, 0]])


def _oriented(turns: Rotation | None, size: int) -> np.ndarray | None:
    """Give rotations the form that a trajectory of ``size`` dimensions stores."""
    if turns is None:
        return None
    if size == 3:
        return turns.as_quat()[:, [3, 0, 1, 2]]
    matrices = turns.as_matrix()
    return np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])


def _lifted(vectors: np.ndarray) -> Float[np.ndarray, "P 3"]:
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
