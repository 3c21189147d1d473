"""What a first rig has to know of frames: whether the truth's axes are those of the fixes."""

import contextlib
from collections.abc import Iterator

import numpy as np

from kedge.core.errors import DataError
from kedge.evaluation.trajectory import Trajectory, associate, umeyama
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table

APART = 0.5
"""m; what is nearer may be the fixes' error."""
NEARER = 3.0
"""Times by which a motion brings fixes nearer to the truth if the frames are not the same."""
FEWEST = 20


def truth_has_own_frame(raw: RawLog) -> bool:
    """Whether a rigid motion brings fixes far nearer to the truth than they are."""
    for fixes, true in _pairs(raw):
        apart = np.linalg.norm(fixes - true, axis=1)
        usual = apart <= np.quantile(apart, 0.9)  # a few are far off
        try:
            motion = umeyama(fixes[usual], true[usual], scaled=False)
        except DataError:
            continue
        nearest = np.median(np.linalg.norm(motion.points(fixes) - true, axis=1))
        if np.median(apart) > max(APART, NEARER * nearest):
            return True
    return False


def _pairs(raw: RawLog) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Fixes of each source, and the truth at their times."""
    if (truth := raw.truth) is None:
        return
    for table in raw.tables.values():
        names = [f"position_{axis}" for axis in "xyz"]
        shared = [n for n in names if n in table.columns and n in truth.columns]
        if len(shared) < 2 or table.texts:
            continue
        with contextlib.suppress(DataError):  # they are not of the same time
            fixes, true = (
                _track(t, shared, int(raw.truth.stamps[0])) for t in (table, raw.truth)
            )
            fixes, true = associate(fixes, true, np.inf)
            if len(fixes.time) >= FEWEST:
                yield fixes.position, true.position


def _track(table: Table, names: list[str], start: int) -> Trajectory:
    points = np.stack([table.columns[name] for name in names], axis=1)
    finite = np.isfinite(points).all(axis=1)
    return Trajectory((table.stamps[finite] - start) / 1e9, points[finite])
