"""Text files as spreadsheets and loggers write them: read where that is unambiguous."""

from datetime import date
from pathlib import Path

import numpy as np
import pytest

from kedge.core.errors import DataError
from kedge.formats.cells import read_cells
from kedge.formats.tables import Column, Table, build_table, check_order, sorted_rows
from kedge.formats.times import TimeForm

PLAIN = "time,x,y\n0.5,1.25,3\n1.0,1.5,-2\n1.5,0.75,10\n2.0,1.0,11\n"
VALUES = {"time": [0.5, 1.0, 1.5, 2.0], "x": [1.25, 1.5, 0.75, 1.0], "y": [3, -2, 10, 11]}


def semicolons(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


READ = {
    "as it should be": PLAIN,
    "semicolons and decimal commas": semicolons(PLAIN),
    "semicolons and points": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "tabs and decimal commas": semicolons(PLAIN).replace(";", "\t"),
    "quoted decimal commas": "time,x,y\n"
    + "".join(
        ",".join(f'"{cell.replace(".", ",")}"' for cell in line.split(",")) + "\n"
        for line in PLAIN.splitlines()[1:]
    ),
    "quoted names after blanks": PLAIN.replace("time,x,y", 'time, "x", "y"'),
    "a line that names the separator": "sep=;\n" + semicolons(PLAIN),
    "comments": "# a yard\n" + PLAIN.replace("1.5,0", "# stop\n1.5,0"),
    "names in a comment": "# " + PLAIN,
    "a row of units": PLAIN.replace("y\n", "y\ns,[m],(m)\n"),
    "a row of units in brackets, of ours or not": PLAIN.replace("y\n", "y\n[-],[°/h],[°C]\n"),
    "a row of units, one without": PLAIN.replace("y\n", "y\ns,°,-\n"),
    "blanks": PLAIN.replace(",", " "),
    "columns of a fixed width": PLAIN.replace(",", "   ").replace("\n", "  \n "),
    "names in a comment, blanks": "# " + PLAIN.replace(",", " "),
    "commas behind each row": PLAIN.replace("\n", ",\n"),
    "commas behind the rows only": PLAIN.replace("3\n", "3,\n").replace("-2\n", "-2,\n"),
    "two columns without a name": PLAIN.replace("\n", ",,\n"),
    "lines of commas": PLAIN + ",,\n,,\n",
    "carriage returns": PLAIN.replace("\n", "\r"),
}


def numbers(path: Path, text: str | bytes) -> dict[str, list[float]]:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    cells = read_cells(path)
    return {name: cells.numbers(name).tolist() for name in VALUES}


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "log.csv"


@pytest.mark.parametrize("text", READ.values(), ids=READ)
def test_what_is_unambiguous_is_read(path, text):
    assert numbers(path, text) == VALUES


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_encodings(path, encoding):
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    assert numbers(path, mark + PLAIN.encode(encoding)) == VALUES


def test_latin_1_and_zeros_at_the_end_are_noted(path):
    path.write_bytes(PLAIN.replace("y\n", "y °\n").encode("latin-1") + bytes(512))
    notes: list[str] = []
    cells = read_cells(path, notes=notes)
    assert cells.numbers("y °").tolist() == VALUES["y"]
    assert [note.partition(": ")[2] for note in notes] == [
        "512 zero bytes at the end were left out",
        "no UTF-8; read as Windows-1252 (Latin-1)",
    ]


def test_thousands_are_read_where_a_point_marks_the_decimals(path):
    path.write_text('time,x\n"1,500.0",1\n"12,000,500.25",2\n')
    assert read_cells(path).numbers("time").tolist() == [1500.0, 12000500.25]
    path.write_text('time,x\n"1,500",1\n"2,500",2\n')
    with pytest.raises(DataError, match=r"csv:2: column 'time': found '1,500', expected a n"):
        read_cells(path).numbers("time")


def test_decimal_commas_between_commas_are_named(path):
    path.write_text("time,x\n0,5,1,25\n")
    with pytest.raises(DataError, match=r"found 4 cells, expected 2.*separate by ;"):
        read_cells(path)


@pytest.mark.parametrize("end", ["2.5,1.", "2.5,1.2", "2.5"])
def test_a_last_line_that_was_cut_is_left_out(path, end):
    path.write_text("time,x\n0.5,1.25\n1.0,1.50\n1.5,0.75\n" + end)
    notes: list[str] = []
    assert read_cells(path, notes=notes).numbers("x").tolist() == [1.25, 1.5, 0.75]
    assert "line 5, the last one, was cut off" in notes[0]
    # With a line break behind it, it is what somebody wrote.
    path.write_text("time,x\n0.5,1.25\n1.0,1.50\n1.5,0.75\n2.5,1.2\n")
    assert read_cells(path).numbers("x").tolist() == [1.25, 1.5, 0.75, 1.2]


def test_words_and_numbers_for_missing(path):
    path.write_text("time,x,y\n0,nan,1\n1,NA,2\n2,null,-32.768\n3,-,4\n4,5,6\n")
    notes: list[str] = []
    table = build_table(
        read_cells(path),
        "imu",
        "time",
        "s",
        {"x": ("x", "m"), "y": Column("y", "cm", (-32.768,))},
        notes=notes,
    )
    np.testing.assert_array_equal(table.columns["x"], [np.nan] * 4 + [5.0])
    np.testing.assert_allclose(table.columns["y"], [0.01, 0.02, np.nan, 0.04, 0.06])
    assert [note.partition(": ")[2].partition(":")[0] for note in notes] == [
        "4 cells of x are missing",
        "1 cells of y are missing",
    ]


def test_a_row_of_units_must_not_contradict_the_log(path):
    path.write_text("time,x\ns,mm\n0,1\n")
    with pytest.raises(DataError, match="row of units says 'mm', the log 'm'"):
        build_table(read_cells(path), "imu", "time", "s", {"x": ("x", "m")})


def test_a_unit_that_nobody_knows_is_noted(path):
    path.write_text("time,x\n[s],[Elle]\n0,1\n")
    notes = []
    build_table(read_cells(path), "imu", "time", "s", {"x": ("x", "m")}, notes=notes)
    assert notes == [
        f"{path.name}: column 'x': its row of units says 'Elle', no unit of ours; 'm' was taken"
    ]


def test_the_sign_of_degrees_is_a_unit(path):
    path.write_text("time,x\ns,°/s\n0,180\n")
    table = build_table(read_cells(path), "imu", "time", "s", {"x": ("x", "deg/s")})
    assert table.columns["x"] == pytest.approx(np.pi)
    with pytest.raises(DataError, match="row of units says '°/s', the log 'rad/s'"):
        build_table(read_cells(path), "imu", "time", "s", {"x": ("x", "rad/s")})


# Seconds since 1970 by the Unix command "date -u +%s -d ...".
NOON = 1715342400
TIMES = {
    "iso, utc": (["2024-05-10T12:00:00Z", "2024-05-10T12:00:00.25Z"], TimeForm()),
    "iso, zones": (["2024-05-10T14:00:00+02:00", "2024-05-10 06:30:00.25-0530"], TimeForm()),
    "iso, a blank": (["2024-05-10 12:00:00", "2024-05-10 12:00:00.250"], TimeForm("ms")),
    "a day's time": (["12:00:00", "12:00:00.25"], TimeForm("s", date(2024, 5, 10))),
    "a spreadsheet's days": (["45422.5", "45422.500002893518518"], TimeForm("days")),
    # 2024-05-10 was the Friday of GPS week 2313; GPS was 18 s ahead of UTC.
    "GPS": (["475218", "475218.25"], TimeForm("week-seconds", week=2313)),
}


@pytest.mark.parametrize(("cells", "form"), TIMES.values(), ids=TIMES)
def test_forms_of_times(path, cells, form):
    path.write_text("time;x\n" + "".join(f"{cell};1\n" for cell in cells))
    stamps = read_cells(path).stamps("time", form)
    assert stamps[0] == NOON * 10**9
    assert stamps[1] == pytest.approx(NOON * 10**9 + 250_000_000, abs=10)


def test_times_of_day_and_of_a_week_go_on(path):
    path.write_text("time,week\n604799.5,2312\n0.5,2313\n")
    cells = read_cells(path)
    for week in (2312, "week"):
        stamps = cells.stamps("time", TimeForm("week-seconds", week=week))
        assert np.diff(stamps).tolist() == [10**9]
    path.write_text("time,x\n23:59:59.5,1\n00:00:00.5,2\n")
    stamps = read_cells(path).stamps("time", TimeForm("s", date(2024, 5, 10)))
    assert np.diff(stamps).tolist() == [10**9]
    with pytest.raises(DataError, match=r'log.csv:2: .* needs date = "YYYY-MM-DD"'):
        read_cells(path).stamps("time")


def timed(stamps: list[float], values: list[float]) -> Table:
    count = len(stamps)
    return Table(
        "gnss",
        Path("gnss.csv"),
        (np.array(stamps) * 1e9).astype(np.int64),
        {"x": np.array(values)},
        {},
        np.arange(2, count + 2),
        {"x": "m"},
    )


def test_rows_are_sorted_only_if_asked_for_and_by_little():
    notes: list[str] = []
    messy = timed([1, 3, 2, 2, 4], [1, 3, 2, 2, 4])
    with pytest.raises(DataError, match=r"gnss.csv:4: .* not go backwards; sort it"):
        check_order(messy, "time", "; sort it")
    assert sorted_rows(messy, "time", notes).columns["x"].tolist() == [1, 2, 3, 4]
    assert len(notes) == 2
    newest_first = timed([30, 20, 10], [3, 2, 1])
    assert sorted_rows(newest_first, "time", notes).columns["x"].tolist() == [1, 2, 3]
    with pytest.raises(DataError, match="again after line 3"):
        sorted_rows(timed([1, 2, 2], [1, 2, 3]), "time", notes)


@pytest.mark.parametrize(
    ("stamps", "looks"),
    [
        ([0, 30, 60, 0, 30], "a second playing"),
        ([86_390, 86_399, 1, 10], "midnight"),
        ([604_000, 604_799, 0, 10], "a new GPS week"),
        ([30, 20, 10], "the newest row comes first"),
    ],
)
def test_what_a_jump_looks_like(stamps, looks):
    table = timed(stamps, stamps)
    with pytest.raises(DataError, match=f"looks like {looks}"):
        check_order(table, "time")
    if looks != "the newest row comes first":
        with pytest.raises(DataError, match=f"looks like {looks}"):
            sorted_rows(table, "time", [])


def test_names_that_are_whole_numbers_and_columns_without_a_gap(tmp_path):
    path = tmp_path / "ranges.csv"
    path.write_text("id,range\n3,1.5\n4.0,\n")
    cells = read_cells(path)
    assert cells.identifiers("id") == ["3", "4"]
    with pytest.raises(
        DataError, match=r"ranges.csv:3: column 'range': found '', expected a n"
    ):
        cells.complete("range")
    for wrong in ("4.5", "", "nan", "inf", "b"):
        path.write_text(f"id,range\n3,1.5\n{wrong},2.0\n")
        with pytest.raises(DataError, match=r"ranges.csv:3: column 'id': .* a whole number"):
            read_cells(path).identifiers("id")
