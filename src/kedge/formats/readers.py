"""Reading a log by the name of its format; ``PATH#PART`` names one vehicle of a data set.

A format is what a reader registers: a function of (path, part or None) that returns a
:class:`~kedge.formats.logs.RawLog`, decorated by ``readers.add("NAME")``.
"""

from pathlib import Path

from kedge.core.errors import ContractError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.formats.bag_config import BagConfig
from kedge.formats.bags import read_bag
from kedge.formats.geodetic import located
from kedge.formats.logs import RawLog
from kedge.formats.origin import OriginConfig


def read_log(
    log: str,
    format: str = "folder",
    bag: BagConfig | None = None,
    origin: OriginConfig | None = None,
) -> RawLog:
    """Read ``PATH`` or ``PATH#PART``; ``bag`` says what the topics of a bag are.

    Latitudes and longitudes become metres from ``origin``; :mod:`kedge.formats.geodetic`.

    Raises:
        ContractError: the reader returns something else.
        ConfigError: a bag without being told its topics.
        UnknownName: no such format, or no such part.
        DataError: the log cannot be used; the message names file, line and column.
    """
    if format not in readers:
        raise UnknownName(unknown("log format", format, readers.names()))
    path, mark, part = log.rpartition("#")
    # A folder may have the mark in its name.
    if not mark or Path(log).exists():
        path, part = log, ""
    reader = readers.get(format)
    if reader is read_bag:
        return located(read_bag(Path(path), part or None, bag), origin)
    raw = reader(Path(path), part or None)
    if not isinstance(raw, RawLog):
        raise ContractError(
            f"the reader {format!r} returns a {type(raw).__name__}; expected a RawLog"
        )
    return located(raw, origin)
