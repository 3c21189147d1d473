"""When a vehicle stands, by its wheel and its IMU together, as readings of a zero."""

import numpy as np
from jaxtyping import Bool, Float

from kedge.config.columns import find_columns
from kedge.config.readings import find_table
from kedge.config.rigs import StandingConfig
from kedge.estimation.log import SECOND
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table

NAME = "standing"
"""The source that it makes."""
UNITS = {"specific_force": "m/s^2", "angular_rate": "rad/s"}
ZEROS = {"velocity": "m/s", "angular_rate": "rad/s"}


def with_standing(config: StandingConfig, raw: RawLog, origin: str) -> RawLog:
    """The log with the source ``standing``: a row of zeros at every time of standing.

    A window without a reading of the wheel is no standing.

    Raises:
        DataError: a source or a column is missing.
    """
    imu = find_table(raw, config.imu, f"{origin}: standing.imu")
    wheel = find_table(raw, config.wheel, f"{origin}: standing.wheel")
    names = {f"{stem}_{axis}": unit for stem, unit in UNITS.items() for axis in "xyz"}
    columns = find_columns(imu, names, {}, "standing")
    speed = find_columns(wheel, {config.column: "m/s"}, {}, "standing")[config.column]
    ends = np.arange(
        imu.stamps[0] + round(config.window * SECOND),
        imu.stamps[-1] + 1,
        round(SECOND / config.rate),
    )
    still = _quiet(config, imu, columns, ends) & _halted(config, wheel, speed, ends)
    stamps = ends[still]
    zero = np.zeros(len(stamps))
    zeros = {f"{stem}_{axis}": unit for stem, unit in ZEROS.items() for axis in "xyz"}
    table = Table(
        NAME, imu.path, stamps, dict.fromkeys(zeros, zero), {}, np.arange(len(stamps)), zeros
    )
    return raw._replace(tables={**raw.tables, NAME: table})


def _quiet(
    config: StandingConfig,
    imu: Table,
    columns: dict[str, Float[np.ndarray, " n"]],
    ends: np.ndarray,
) -> Bool[np.ndarray, " k"]:
    """Whether each axis of the IMU varies little over the window before each end."""
    high = np.searchsorted(imu.stamps, ends, side="right")
    low = np.searchsorted(imu.stamps, ends - round(config.window * SECOND))
    count, quiet = np.maximum(high - low, 1), high - low >= 3
    for name, values in columns.items():
        centred = values - values.mean()
        sums, squares = (np.append(0.0, np.cumsum(v)) for v in (centred, centred**2))
        mean = (sums[high] - sums[low]) / count
        variance = (squares[high] - squares[low]) / count - mean**2
        bound = config.force_std if name.startswith("specific_force") else config.rate_std
        quiet &= variance < bound**2
    return quiet


def _halted(
    config: StandingConfig, wheel: Table, speed: Float[np.ndarray, " n"], ends: np.ndarray
) -> Bool[np.ndarray, " k"]:
    """Whether the wheel was read within the window before each end, and never moved in it."""
    high = np.searchsorted(wheel.stamps, ends, side="right")
    low = np.searchsorted(wheel.stamps, ends - round(config.window * SECOND))
    moving_count = np.append(0, np.cumsum(~(np.abs(speed) < config.speed)))
    return (high > low) & (moving_count[high] == moving_count[low])
