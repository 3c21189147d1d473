"""Reading a log by the name of its format; ``PATH#PART`` names one vehicle of a data set."""

import importlib
from pathlib import Path

from kedge.core.errors import UnknownName
from kedge.core.registry import unknown
from kedge.formats.bag_config import BagConfig
from kedge.formats.bags import read_bag
from kedge.formats.logs import RawLog

FORMATS = {
    "euroc_mh01_imu": "kedge.datasets.euroc:read_euroc",
    "folder": "kedge.formats.logs:read_folder",
    "auv_akit_snapir": "kedge.datasets.akit:read_akit",
    "hanyang_uwb": "kedge.datasets.hanyang:read_hanyang",
    "labyrinth": "kedge.datasets.labyrinth:read_labyrinth",
    "lias_trolley": "kedge.datasets.lias:read_lias",
    "mrclam": "kedge.datasets.mrclam:read_mrclam",
    "navego_synthetic": "kedge.datasets.navego:read_navego",
    "plaza": "kedge.datasets.plaza:read_plaza",
    "starloc": "kedge.datasets.starloc:read_starloc",
    "trek1000": "kedge.datasets.trek1000:read_trek1000",
}
"""Format -> ``module:function`` of (path, part or None); imported when it is asked for."""


BAGS = "bag", "mcap"
"""Formats whose topics a rig has to name; both read whatever kind of bag it is."""


def read_log(log: str, format: str = "folder", bag: BagConfig | None = None) -> RawLog:
    """Read ``PATH`` or ``PATH#PART``; ``bag`` says what the topics of a bag are.

    Raises:
        ConfigError: a bag without being told its topics.
        UnknownName: no such format, or no such part.
        DataError: the log cannot be used; the message names file, line and column.
    """
    if format not in (*FORMATS, *BAGS):
        raise UnknownName(unknown("log format", format, sorted((*FORMATS, *BAGS))))
    path, mark, part = log.rpartition("#")
    # A folder may have the mark in its name.
    if not mark or Path(log).exists():
        path, part = log, ""
    if format in BAGS:
        return read_bag(Path(path), part or None, bag)
    module, _, function = FORMATS[format].partition(":")
    return getattr(importlib.import_module(module), function)(Path(path), part or None)
