"""The TREK1000 room: a tag on a tripod, four anchors, a person who blocks one, Vicon truth.

Source: C. L. Sang, M. Adams, T. Hörmann, M. Hesse, M. Porrmann, U. Rückert, "Numerical and
experimental evaluation of error estimation for two-way ranging methods", Sensors 19(3), 2019:
its authors' recordings, github.com/cliansang/positioning-algorithms-for-uwb-matlab.
"""

from pathlib import Path

import numpy as np

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.formats.cells import Cells, read_cells
from kedge.formats.logs import RawLog
from kedge.formats.matlab import read_matrix
from kedge.formats.tables import Table

STEM = "output_range_uwb_"
ANCHORS = ("0", "1", "2", "3")
ORIGIN = (2.200717, 2.926282)
"""Of the room in Vicon's frame, which is turned by half a turn; m."""
EVERY = 12
"""Of Vicon's poses, 120 a second, one in so many is kept."""
DAY = 86400.0


@readers.add("trek1000")
def read_trek1000(path: Path, part: str | None = None) -> RawLog:
    """Read one case: the ranges of a file, and Vicon's poses beside it if they are there.

    Stamps are local time since midnight, as the ranges have it; ranges that are not positive
    are dropped, and ``notes`` says how many there were.

    Args:
        path: a file ``output_range_uwb_CASE.txt``, or a folder of them.
        part: the case, such as 4vnm or 4vba0; not needed for a file, or for a folder of one.

    Raises:
        DataError: no such file, or one that cannot be used.
        UnknownName: no such case.
    """
    file = _file(path, part)
    case = file.stem.removeprefix(STEM)
    header = ("time", "tag", *ANCHORS)
    cells = read_cells(file, header)
    stamps = _stamps(cells)
    rows = [np.round(cells.numbers(anchor), 6) / 1000 for anchor in ANCHORS]
    ranges = np.stack(rows, axis=1)
    good = ranges > 0
    which = np.nonzero(good)
    notes = []
    if bad := int((~good).sum()):
        notes.append(f"ranges: {bad} ranges that are not above 0 were dropped")
    table = Table(
        "ranges",
        file,
        stamps[which[0]],
        {"range": ranges[good]},
        {"target": [ANCHORS[at] for at in which[1].tolist()]},
        cells.lines[which[0]],
        {"range": "m"},
    )
    truth = _truth(file, case, stamps)
    files = (file,) if truth is None else (file, truth.path)
    title = f"TREK1000 room, {case}"
    return RawLog(title, {"ranges": table}, truth, {}, files, tuple(notes), "local midnight")


def _file(path: Path, part: str | None) -> Path:
    if path.is_file():
        return path
    cases = {f.stem.removeprefix(STEM): f for f in sorted(path.glob(f"{STEM}*.txt"))}
    if not cases:
        raise DataError(f"{path}: expected files {STEM}CASE.txt, or one of them; found none")
    if part is None and len(cases) == 1:
        return next(iter(cases.values()))
    if part is None:
        choice = ", ".join(f"{path.name}#{case}" for case in cases)
        raise DataError(f"{path}: expected a case after the path; there are {choice}")
    if part not in cases:
        raise UnknownName(f"{path}: {unknown('case', part, list(cases))}")
    return cases[part]


def _stamps(cells: Cells) -> np.ndarray:
    """Times since midnight in ns, from HHMMSSmmm.

    Raises:
        DataError: a time that no clock shows, or that goes backwards.
    """
    text = cells.text("time")
    stamps = []
    for at, cell in enumerate(text):
        place = f"{cells.path}:{cells.lines[at]}: column 'time'"
        digits = cell.zfill(9)
        if not (digits.isdigit() and len(digits) == 9):
            raise DataError(f"{place}: found {cell!r}, expected a time as HHMMSSmmm")
        hours, minutes, seconds = int(digits[:2]), int(digits[2:4]), int(digits[4:6])
        if hours > 23 or minutes > 59 or seconds > 59:
            raise DataError(f"{place}: found {cell!r}, expected a time as HHMMSSmmm")
        whole = (hours * 60 + minutes) * 60 + seconds
        stamps.append((whole * 1000 + int(digits[6:])) * 1_000_000)
        if at and stamps[-1] <= stamps[-2]:
            raise DataError(f"{place}: found {cell!r} after {text[at - 1]!r}, expected a later")
    return np.array(stamps, np.int64)


def _truth(file: Path, case: str, stamps: np.ndarray) -> Table | None:
    """Vicon's poses in the room, at local time; None if there is no file of them."""
    wanted = f"{case}.mat".lower()
    match = next((f for f in sorted(file.parent.iterdir()) if f.name.lower() == wanted), None)
    if match is None:
        return None
    poses = read_matrix(match, "posedata_uwb")[::EVERY]
    if poses.ndim != 2 or poses.shape[1] < 5 or len(poses) < 2 or not np.isfinite(poses).all():
        raise DataError(
            f"{match}: posedata_uwb: found the shape {poses.shape}, expected rows of at least "
            "five finite numbers"
        )
    unix = poses[:, 1] + 1e-9 * poses[:, 2]
    # Both clocks show the same hour but for the zone.
    zone = round((stamps[0] / 1e9 - unix[0] % DAY) / 3600) * 3600
    local = np.round((unix % DAY + zone) % DAY * 1e9).astype(np.int64)
    rising = np.flatnonzero(np.diff(local, prepend=local[0] - 1) > 0)
    columns = {
        f"position_{axis}": -(poses[rising, 3 + at] - ORIGIN[at])
        for at, axis in enumerate("xy")
    }
    lines = rising * EVERY + 1
    return Table("truth", match, local[rising], columns, {}, lines, dict.fromkeys(columns, "m"))
