import gzip
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from kedge.core.errors import DataError
from kedge.formats.cells import read_cells
from kedge.formats.tables import Table, build_table, check_order
from kedge.formats.units import UNITS, to_enu


def table(path: Path, text: str, time_unit: str = "s", **options) -> Table:
    path.write_text(text, encoding="utf-8")
    cells = read_cells(path)
    columns = {"range": ("range", options.pop("unit", "m"))}
    built = build_table(cells, "uwb", "time", time_unit, columns, **options)
    check_order(built, "time")
    return built


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "uwb.csv"


@pytest.mark.parametrize(
    ("unit", "text", "stamp"),
    [
        ("s", "1248272265.123456789", 1248272265123456789),
        ("s", "-0.000000001", -1),
        ("s", "1.5e3", 1500000000000),
        ("ms", "1248272265123.456789", 1248272265123456789),
        ("us", "1248272265123456.789", 1248272265123456789),
        ("ns", "1248272265123456789", 1248272265123456789),
    ],
)
def test_stamps_are_exact(path, unit, text, stamp):
    assert table(path, f"time,range\n{text},1\n", unit).stamps.tolist() == [stamp]


def test_factors_against_their_definitions():
    # Each unit by its definition in lengths, times and parts of a turn.
    assert UNITS["kn"][1] * 3600 == pytest.approx(1852, rel=1e-15)
    assert UNITS["km/h"][1] * 3600 == pytest.approx(1000, rel=1e-15)
    assert UNITS["deg"][1] * 180 == pytest.approx(np.pi, rel=1e-15)
    assert Decimal("0.3048") == Decimal(str(UNITS["ft"][1]))
    assert all(UNITS[si] == (si, 1.0) for si, _ in UNITS.values())


def test_values_are_converted_and_know_their_line(path):
    read = table(path, "time,range\n0,100\n\n1,250\n", unit="cm")
    np.testing.assert_allclose(read.columns["range"], [1.0, 2.5])
    assert read.units == {"range": "m"}
    assert read.lines.tolist() == [2, 4]


def test_an_empty_cell_is_a_missing_component(path):
    read = table(path, "time,range\n0,\n1,2\n")
    np.testing.assert_array_equal(read.columns["range"], [np.nan, 2.0])


def test_rejected_values_come_out_as_infinities(path):
    read = table(path, "time,range\n0,nan\n1,-inf\n2,\n", not_finite="reject")
    np.testing.assert_array_equal(read.columns["range"], [np.inf, -np.inf, np.nan])


def test_packed_files_and_a_byte_order_mark(path):
    packed = path.with_suffix(".csv.gz")
    packed.write_bytes(gzip.compress("\ufefftime,range\n0,1\n".encode()))
    assert read_cells(packed).columns == {"time": ["0"], "range": ["1"]}


def test_columns_between_blanks(path):
    path.write_text("# time range\n 0.5 \t 1.25  # near\n\n1.5 2\n")
    cells = read_cells(path, ("time", "range"))
    assert cells.columns == {"time": ["0.5", "1.5"], "range": ["1.25", "2"]}
    assert cells.lines.tolist() == [2, 4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "time,rng\n0,1\n",
            "{path}:1: no column called 'range' (did you mean 'rng'?); there are",
        ),
        (
            "time,range\n0,1\n1,abc\n",
            "{path}:3: column 'range': found 'abc', expected a number",
        ),
        (
            "time,range\n0,1\n1,1_0\n",
            "{path}:3: column 'range': found '1_0', expected a number",
        ),
        ("time,range\n0,1\nx,1\n", "{path}:3: column 'time': found 'x', expected a time"),
        ("time,range\n0,1\ninf,1\n", "{path}:3: column 'time': found 'inf', expected a time"),
        ("time,range\n,1\n", "{path}:2: column 'time': found '', expected a time"),
        ("time,range\n1e12,1\n", "{path}:2: column 'time': found '1e12', expected a time in s"),
        ("time,range\n0,1\n1,1,2\n", "{path}:3: found 3 cells, expected 2: time, range"),
        (
            "time,range\n0,1\n1,inf\n",
            "{path}:3: column 'range': found 'inf', expected a finite",
        ),
        ("time,range\n0,1e999\n", "{path}:2: column 'range': found '1e999', expected a finite"),
        ("time,range\n", "{path}: empty log: found no rows"),
        ("", "{path}: empty log: found no rows"),
        ("time,range,time\n0,1,2\n", "{path}:1: two columns are called 'time'"),
        ('time,range\n0,"1\n', "{path}:2: no readable CSV"),
        (
            "time,range\n2,1\n1,1\n",
            "{path}:3: column 'time': found 1000000000 ns after 2000000000",
        ),
        (
            "time,range\n1,1\n1,2\n",
            "{path}:3: column 'time': found 1000000000 ns again after line 2",
        ),
    ],
)
def test_what_is_wrong_is_said_in_one_line(path, text, message):
    with pytest.raises(DataError) as caught:
        table(path, text)
    assert str(caught.value).startswith(message.format(path=path))
    assert "\n" not in str(caught.value)


def test_one_stamp_for_two_targets_is_fine_but_not_for_one(path):
    text = "time,range,tag\n0,1,a\n0,1,b\n1,1,a\n"
    assert table(path, text, target="tag").texts == {"tag": ["a", "b", "a"]}
    with pytest.raises(DataError, match=r"uwb.csv:5: .* ns and 'a' again after line 4"):
        table(path, text + "1,2,a\n", target="tag")


def test_unknown_units(path):
    with pytest.raises(DataError, match=r"column 'range': no unit called 'metres'"):
        table(path, "time,range\n0,1\n", unit="metres")
    with pytest.raises(DataError, match=r"column 'time': no unit called 'h'"):
        table(path, "time,range\n0,1\n", "h")


def test_files_that_cannot_be_read(path):
    with pytest.raises(DataError, match="no such file"):
        read_cells(path)
    path.with_suffix(".gz").write_bytes(b"not packed")
    with pytest.raises(DataError, match="cannot be read"):
        read_cells(path.with_suffix(".gz"))
    path.write_bytes(b"time,range\n0\x00,1\n")
    with pytest.raises(DataError, match=r"uwb.csv:2: found a zero byte"):
        read_cells(path)


@pytest.mark.parametrize(
    ("name", "value", "inside", "turned"),
    [
        ("position_x", 2.0, "position_y", 2.0),  # north
        ("position_y", 3.0, "position_x", 3.0),  # east
        ("position_z", 4.0, "position_z", -4.0),  # down
        ("velocity_x_std", 0.5, "velocity_y_std", 0.5),
        ("force_body_y", 1.0, "force_body_y", -1.0),
        ("force_body_x", 1.0, "force_body_x", 1.0),
        ("heading", 0.0, "heading", np.pi / 2),  # north
        ("heading", np.pi / 2, "heading", 0.0),  # east
        ("heading", -np.pi, "heading", -np.pi / 2),  # south, wrapped
        ("yaw_rate", 0.2, "yaw_rate", -0.2),
        ("bearing", 0.2, "bearing", -0.2),
        ("speed", 1.5, "speed", 1.5),
    ],
)
def test_ned_becomes_enu(path, name, value, inside, turned):
    found, values = to_enu(path, name, "1", np.array([value]))
    assert found == inside
    np.testing.assert_allclose(values, [turned], atol=1e-15)


def test_what_no_single_column_can_turn_is_refused(path):
    for name, unit in (("attitude_w", "1"), ("attitude_x", "1")):
        with pytest.raises(DataError, match=f"column '{name}': cannot be converted"):
            to_enu(path, name, unit, np.zeros(1))
    assert to_enu(path, "acceleration", "m/s^2", np.ones(1))[0] == "acceleration"
