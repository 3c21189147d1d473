"""The truth of a log, and the pose at which a prior takes its start."""

import jax
import numpy as np
from jaxtyping import Float

from kedge.config.columns import find_columns
from kedge.config.readings import find_table, join
from kedge.config.rigs import RigConfig
from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import DataError
from kedge.core.manifolds import Chart, charts_of, columns_of, space_of
from kedge.core.registry import unknown
from kedge.estimation.log import SECOND, Truth
from kedge.formats.attitudes import require_rotations
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table, require_finite


def reference_of(raw: RawLog, truth: str) -> Table | None:
    """The source to compare with: the log's own truth, none, or one by name.

    Raises:
        DataError: there is none of that name.
    """
    if truth == "none":
        return None
    if truth == "auto" or (raw.truth is not None and truth == raw.truth.name):
        return raw.truth
    return find_table(raw, truth, "--truth")


def pose_table(config: RigConfig, raw: RawLog, reference: Table | None) -> Table:
    """Where the prior's ``from_truth`` takes poses from, at the times of the events.

    The source of a sensor is late by the sensor's latency.

    Raises:
        DataError: there is no such source, or no truth.
    """
    if (name := config.prior.source) is not None:
        table = find_table(raw, name, f"{config.origin}: prior.source")
        late = {s.latency for key, s in config.sensors.items() if (s.source or key) == name}
        # Sensors of one source that are late by different times do not say when it was.
        latency = late.pop() if len(late) == 1 else 0.0
        return table._replace(stamps=table.stamps - round(latency * SECOND))
    table = raw.truth if reference is None else reference
    if table is None:
        raise DataError(
            f"{config.origin}: prior.from_truth needs a true pose, but the log has no truth"
        )
    return table


def truth_of(
    config: RigConfig, table: Table, vehicle: AbstractVehicle, start: int, end: int
) -> Truth:
    """The true trajectory from ``start`` to ``end``, with a pose before and behind for between.

    Raises:
        DataError: it has no field of the state, or is of another time.
    """
    fields = {
        field: _field(table, field, chart)
        for field, chart in charts_of(type(vehicle.start())).items()
        if all(name in table.columns for name in columns_of(field, chart))
    }
    if not fields:
        wanted = ", ".join(space_of(type(vehicle.start())).column_units)
        raise DataError(
            f"{table.path}: truth: found columns {', '.join(table.columns)}, expected some of "
            f"{wanted}"
        )
    check_overlap(table, start, end)
    low = max(int(np.searchsorted(table.stamps, start, side="right")) - 1, 0)
    high = int(np.searchsorted(table.stamps, end, side="left")) + 1
    time = (table.stamps[low:high] - start) / SECOND
    cut = {name: values[low:high] for name, values in fields.items()}
    return Truth(time, cut, config.truth.own_frame)


def check_overlap(table: Table, start: int, end: int) -> None:
    """See that a truth is of the time of the controls and readings.

    Raises:
        DataError: it is of another.
    """
    first, last = int(table.stamps[0]), int(table.stamps[-1])
    if last < start or first > end:
        raise DataError(
            f"{table.path}: truth does not overlap in time: it spans {_span(first, last)}, the "
            f"controls and readings {_span(start, end)}"
        )


def _field(table: Table, field: str, chart: Chart) -> Float[np.ndarray, "n ..."]:
    names = columns_of(field, chart)
    unit = chart.unit if chart.shape == chart.tangent_shape else "1"
    columns = find_columns(table, dict.fromkeys(names, unit), {}, "truth")
    require_finite(table, names, "truth")
    values = join(columns, names, (len(table.stamps), *chart.shape))
    if chart.shape != chart.tangent_shape:
        require_rotations(table.path, table.lines, values, f"truth: {field}")
    return values


def _span(first: int, last: int) -> str:
    def seconds(stamp: int) -> str:
        return f"{'-' if stamp < 0 else ''}{abs(stamp) // SECOND}.{abs(stamp) % SECOND:09d}"

    return f"{seconds(first)} s to {seconds(last)} s"


def pose_at(table: Table, field: str, chart: Chart, stamp: int) -> np.ndarray:
    """A true field at ``stamp``: between two poses by the chart, outside the nearest."""
    if absent := [name for name in columns_of(field, chart) if name not in table.columns]:
        what = unknown("column", absent[0], list(table.columns))
        raise DataError(f"{table.path}: {what} (for prior.from_truth)")
    values = _field(table, field, chart)
    after = int(np.clip(np.searchsorted(table.stamps, stamp), 1, max(len(values) - 1, 1)))
    if len(values) == 1:
        return values[0]
    low, high = table.stamps[after - 1], table.stamps[after]
    share = float(np.clip((stamp - low) / (high - low), 0.0, 1.0))

    @jax.jit  # one program to compile instead of ten
    def between(before, behind, share):
        return chart.boxplus(before, share * chart.boxminus(behind, before))

    return np.asarray(between(values[after - 1], values[after], share))
