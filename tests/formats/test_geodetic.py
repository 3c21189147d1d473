"""Latitudes and longitudes as metres: NMEA, GPX, folders; against formulas written here."""

import functools
import operator
from pathlib import Path

import numpy as np
import pytest

from kedge.core.errors import DataError
from kedge.formats.geodetic import located
from kedge.formats.logs import RawLog
from kedge.formats.origin import OriginConfig
from kedge.formats.readers import read_log
from kedge.formats.tables import table_of

A, E2 = 6378137.0, 1 / 298.257223563 * (2 - 1 / 298.257223563)


def ecef(latitude, longitude, height):
    """Bowring's figure: where a place lies from the centre of the earth."""
    normal = A / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    out = (normal + height) * np.cos(latitude)
    up = (normal * (1 - E2) + height) * np.sin(latitude)
    return np.stack([out * np.cos(longitude), out * np.sin(longitude), up])


def east_north_up(place, origin):
    """The difference of two places, along the axes of the second."""
    away = ecef(*place) - ecef(*origin)[:, None]
    (lat, lon), (s, c) = origin[:2], (np.sin, np.cos)
    axes = np.array(
        [
            [-s(lon), c(lon), 0],
            [-s(lat) * c(lon), -s(lat) * s(lon), c(lat)],
            [c(lat) * c(lon), c(lat) * s(lon), s(lat)],
        ]
    )
    return axes @ away


def fixes(**columns):
    units = {"latitude": "deg", "longitude": "deg", "altitude": "m", "status": "1"}
    count = len(columns["latitude"])
    values = {name: (np.array(v, float), units[name]) for name, v in columns.items()}
    table = table_of("gnss", Path("gnss.csv"), np.arange(count), values)
    return RawLog("drive", {"gnss": table})


PLACES = {
    "latitude": [48.0, 48.01, 47.9],
    "longitude": [9.0, 9.02, 9.1],
    "altitude": [500.0, 520.0, 480.0],
}


def test_places_are_metres_along_the_axes_of_the_origin():
    found = located(fixes(**PLACES), OriginConfig(latitude=47.95, longitude=9.05, height=450.0))
    place = [np.radians(PLACES[n]) for n in ("latitude", "longitude")] + [
        np.array(PLACES["altitude"])
    ]
    expected = east_north_up(place, [np.radians(47.95), np.radians(9.05), 450.0])
    columns = found.tables["gnss"].columns
    for axis, values in zip("xyz", expected, strict=True):
        np.testing.assert_allclose(columns[f"position_{axis}"], values, atol=1e-6)
    assert not columns.keys() & {"latitude", "longitude"}
    np.testing.assert_allclose(found.place["latitude"], np.radians(47.95))


def test_the_first_fix_is_the_origin_unless_one_is_given():
    found = located(fixes(**PLACES))
    columns = found.tables["gnss"].columns
    np.testing.assert_allclose([columns[f"position_{a}"][0] for a in "xyz"], 0, atol=1e-8)
    assert "48.00000000, 9.00000000 deg, 500.00 m (the first fix of gnss)" in found.notes[-1]


def test_without_heights_all_is_at_the_origins():
    plane = {name: PLACES[name] for name in ("latitude", "longitude")}
    columns = located(fixes(**plane)).tables["gnss"].columns
    assert "position_z" not in columns


def test_a_fix_that_is_none_is_left_out():
    raw = fixes(
        latitude=[0.0, 48.0, 48.1, 48.2, np.nan],
        longitude=[0.0, 9, 9, 9, 9],
        status=[0, 0, -1, 0, 0],
    )
    found = located(raw)
    assert found.tables["gnss"].stamps.tolist() == [1, 3, 4]
    assert np.isnan(found.tables["gnss"].columns["position_x"][-1])
    assert "1 readings without a fix (status below 0)" in found.notes[0]
    assert "1 readings without a fix (at 0, 0)" in found.notes[1]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"latitude": [123.0], "longitude": [9.0]},
            r"csv:1: gnss: found a latitude of 123",
        ),
        ({"latitude": [0.0], "longitude": [0.0]}, "found no fix at all"),
        ({"latitude": [np.nan], "longitude": [9.0]}, "found no fix to take the origin from"),
    ],
)
def test_what_is_nowhere_on_earth_is_refused(columns, message):
    with pytest.raises(DataError, match=message):
        located(fixes(**columns))


def test_a_place_on_another_continent_is_noticed():
    found = located(fixes(**PLACES), OriginConfig(latitude=0, longitude=0))
    assert "km from the origin; is it the right one?" in found.notes[-1]


def folder(tmp_path, columns, status="0,-1,0"):
    rows = zip("012", ("48.0", "48.00001", "48.00002"), status.split(","), strict=True)
    body = "".join(f"{t},{lat},9.0,{state}\n" for t, lat, state in rows)
    (tmp_path / "gnss.csv").write_text(f"time,latitude,longitude,status\n{body}")
    (tmp_path / "log.toml").write_text(f"[sources.gnss]\ncolumns = {columns}\n")
    return str(tmp_path)


def test_a_folder_of_degrees_drops_what_its_status_calls_no_fix(tmp_path):
    raw = read_log(folder(tmp_path, '{ latitude = "deg", longitude = "deg" }'))
    assert raw.tables["gnss"].stamps.tolist() == [0, 2 * 10**9]
    np.testing.assert_allclose(raw.tables["gnss"].columns["position_y"], [0, 2.224], atol=1e-3)


def test_degrees_that_are_called_metres_are_refused(tmp_path):
    columns = '{ latitude = { unit = "m", name = "position_y" }, longitude = "deg" }'
    with pytest.raises(DataError, match=r"toml:2: .*latitude: found unit 'm', expected deg"):
        read_log(folder(tmp_path, columns))


def sentence(text):
    return f"${text}*{functools.reduce(operator.xor, map(ord, text)):02X}"


def gga(time, minutes, quality=1):
    place = f"48{minutes:09.6f},N,00900.000000,E"
    return sentence(f"GPGGA,{time},{place},{quality},08,0.9,500.0,M,48.0,M,,")


def test_nmea_goes_on_across_midnight(tmp_path):
    path = tmp_path / "drive.nmea"
    lines = [
        gga("235959.00", 0.0),
        sentence("GPRMC,235959.00,A,4800.0,N,00900.0,E,10.0,090.0,311223,,,A"),
        gga("235959.50", 0.1),
        "17.25 " + gga("000000.00", 0.2),
        sentence("GPRMC,000000.00,A,4800.0,N,00900.0,E,10.0,180.0,010124,,,A"),
        gga("000000.50", 0.3, quality=0),
        gga("000001.00", 0.4)[:-1] + "Z",
        "!AIVDM,not for us",
    ]
    path.write_text("\r\n".join(lines))
    raw = read_log(str(path), "nmea")
    first = 1_704_067_199 * 10**9  # date -ud 2023-12-31T23:59:59 +%s
    gnss, velocity = raw.tables["gnss"], raw.tables["velocity"]
    np.testing.assert_array_equal(gnss.stamps - first, [0, 5 * 10**8, 10**9])
    np.testing.assert_allclose(gnss.columns["position_y"], [0, 185.3, 370.7], atol=0.1)
    np.testing.assert_array_equal(velocity.stamps - first, [0, 10**9])
    knots = 10 * 1852 / 3600
    np.testing.assert_allclose(velocity.columns["velocity_x"], [knots, 0], atol=1e-12)
    np.testing.assert_allclose(velocity.columns["velocity_y"], [0, -knots], atol=1e-12)
    assert "1 damaged sentences were left out, the first in line 7" in raw.notes[0]
    assert any("1 readings without a fix (quality 0)" in note for note in raw.notes)
    assert raw.epoch == "Unix"
    np.testing.assert_allclose(raw.place["height"], 548.0)


def test_nmea_without_a_date_counts_from_midnight(tmp_path):
    path = tmp_path / "drive.nmea"
    path.write_text("\n".join([gga("235959.00", 0.0), gga("000000.00", 0.1)]))
    raw = read_log(str(path), "nmea")
    assert raw.tables["gnss"].stamps.tolist() == [86_399 * 10**9, 86_400 * 10**9]
    assert raw.epoch.startswith("midnight")


def test_nmea_without_a_place_is_refused(tmp_path):
    (tmp_path / "a.nmea").write_text(sentence("GPVTG,054.7,T,034.4,M,005.5,N,010.2,K"))
    with pytest.raises(DataError, match=r"a\.nmea: found no GGA"):
        read_log(str(tmp_path / "a.nmea"), "nmea")


POINT = '<trkpt lat="{}" lon="9.0"><ele>500</ele><time>{}</time></trkpt>'
GPX = '<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{}</trkseg></trk></gpx>'


def test_the_points_of_a_track(tmp_path):
    times = ("2024-01-01T00:00:00Z", "2024-01-01T01:00:00.250+01:00")
    points = "".join(POINT.format(48 + k / 1000, time) for k, time in enumerate(times))
    (tmp_path / "a.gpx").write_text(GPX.format(points))
    table = read_log(str(tmp_path / "a.gpx"), "gpx").tables["gnss"]
    assert (table.stamps - 1_704_067_200 * 10**9).tolist() == [0, 250_000_000]
    np.testing.assert_allclose(table.columns["position_y"], [0, 111.2], atol=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<gpx", "no readable GPX"),
        (GPX.format(""), "found no track point"),
        (
            GPX.format(POINT.format("48.0", "noon")),
            "time = 48.0, 9.0, noon",
        ),
        (GPX.format(POINT.format("north", "2024-01-01T00:00:00Z")), "point 1: found lat"),
    ],
)
def test_what_is_no_track_is_refused(text, message, tmp_path):
    (tmp_path / "a.gpx").write_text(text)
    with pytest.raises(DataError, match=message):
        read_log(str(tmp_path / "a.gpx"), "gpx")
