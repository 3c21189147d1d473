"""Bad input: exit code 2, one clear message, nothing written."""

import os
import re

import pytest


def replace(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


def line(path, number, text):
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join(lines) + "\n")


def missing_file(site):
    (site / "log" / "camera.csv").unlink()
    return ["camera.csv"]


def missing_log(site):
    (site / "log").rename(site / "elsewhere")
    return ["log", "no such folder"]


def missing_column(site):
    line(site / "log" / "camera.csv", 1, "time,post,distance,bearing")
    return ["camera.csv", "range", "distance"]


def wrong_unit(site):
    replace(site / "log" / "log.toml", 'range = "m"', 'range = "furlong"')
    return ["log.toml", "sources.camera.columns.range", "furlong"]


def unit_of_another_kind(site):
    replace(site / "log" / "log.toml", 'range = "m"', 'range = "s"')
    return ["range", "s", "m"]


def time_going_backwards(site):
    line(site / "log" / "odometry.csv", 12, "0.3,1.0,11.0")
    return ["odometry.csv:12", "300000000 ns", "backwards"]


def time_duplicated(site):
    lines = (site / "log" / "odometry.csv").read_text().splitlines()
    line(site / "log" / "odometry.csv", 12, lines[10])
    return ["odometry.csv", "12"]


def infinity_in_a_reading(site):
    line(site / "log" / "camera.csv", 4, "1.5,a,3.0,inf")
    return ["camera.csv", "4", "bearing", "inf"]


def infinity_in_a_control(site):
    line(site / "log" / "odometry.csv", 9, "0.7,inf,0.0")
    return ["odometry.csv", "9", "speed", "inf"]


def infinity_in_a_covariance(site):
    lines = (site / "log" / "camera.csv").read_text().splitlines()
    rows = [f"{row},0.01,0.0,0.0004" for row in lines[1:]]
    rows[2] = f"{lines[3]},inf,0.0,0.0004"
    text = "\n".join(["time,post,range,bearing,rr,rb,bb", *rows]) + "\n"
    (site / "log" / "camera.csv").write_text(text)
    replace(
        site / "log" / "log.toml",
        'columns = { range = "m", bearing = "rad" }',
        'columns = { range = "m", bearing = "rad", rr = "m^2", rb = "m*rad", bb = "rad^2" }',
    )
    replace(site / "rig.toml", "gate = 0.01", 'covariance = ["rr", "rb", "bb"]')
    return ["camera.csv", "4", "rr", "inf"]


def sensor_reads_a_field_that_is_not_there(site):
    replace(site / "rig.toml", 'model = "unicycle"', 'model = "constant-velocity"')
    replace(
        site / "rig.toml",
        "parameters = { speed_noise = 0.1, yaw_rate_noise = 0.02 }",
        "",
    )
    replace(site / "rig.toml", '\n[control]\nsource = "odometry"\n', "")
    replace(site / "rig.toml", 'from_truth = ["position", "heading"]', "")
    replace(site / "rig.toml", "heading = 0.05", "velocity = 0.05")
    return ["rig.toml", "Landmarks", "heading"]


def unknown_key(site):
    replace(site / "rig.toml", "gate = 0.01", "gait = 0.01")
    return ["rig.toml", "sensors.camera.gait", "gate"]


def two_mistakes_at_once(site):
    replace(site / "rig.toml", "gate = 0.01", "gait = 0.01")
    replace(site / "rig.toml", "rate = 5.0", "rate = -5.0")
    return ["sensors.camera.gait", "output.rate"]


def covariance_not_positive_definite(site):
    replace(
        site / "rig.toml",
        "std = { position = 0.1, heading = 0.05 }",
        "covariance = [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]",
    )
    return ["rig.toml", "prior.covariance", "positive definite"]


def empty_log(site):
    for name in ("odometry", "camera"):
        path = site / "log" / f"{name}.csv"
        path.write_text(path.read_text().splitlines()[0] + "\n")
    return ["empty"]


def truth_of_another_time(site):
    path = site / "log" / "truth.csv"
    lines = path.read_text().splitlines()
    moved = [f"{float(row.split(',')[0]) + 1000},{row.split(',', 1)[1]}" for row in lines[1:]]
    path.write_text("\n".join([lines[0], *moved]) + "\n")
    replace(site / "rig.toml", 'from_truth = ["position", "heading"]', "")
    return ["truth.csv", "overlap"]


def unknown_rig_model(site):
    replace(site / "rig.toml", '"unicycle"', '"unicicle"')
    return ["rig.toml", "vehicle.model", "unicycle"]


def toml_that_is_none(site):
    replace(site / "rig.toml", "gate = 0.01", "gate = = 0.01")
    return ["rig.toml", "line"]


CASES = [
    missing_file,
    missing_log,
    missing_column,
    wrong_unit,
    unit_of_another_kind,
    time_going_backwards,
    time_duplicated,
    infinity_in_a_reading,
    infinity_in_a_control,
    infinity_in_a_covariance,
    sensor_reads_a_field_that_is_not_there,
    unknown_key,
    two_mistakes_at_once,
    covariance_not_positive_definite,
    empty_log,
    truth_of_another_time,
    unknown_rig_model,
    toml_that_is_none,
]


@pytest.mark.parametrize("spoil", CASES, ids=lambda case: case.__name__)
def test_one_message_exit_2_nothing_written(spoil, site, kedge):
    expected = spoil(site)
    code, out, err = kedge("estimate", site / "rig.toml", site / "log", "--out", site / "out")
    message = [text for text in err.splitlines() if not re.match(r"\[ *[\d.]+ s\]", text)]
    assert code == 2, err
    assert message[0].startswith("kedge: ")
    assert "Traceback" not in err
    for part in expected:
        assert part in "\n".join(message), part
    assert out == ""
    assert sorted(p.name for p in site.iterdir() if p.name.startswith((".", "out"))) == []


NESTED = f"{'gated:inner=(' * 2000}extended{')' * 2000}"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--filter", "extendet"], ["extendet", "extended"]),
        (["--filter", "particle:cuont=5"], ["cuont", "count"]),
        (["--filter", "kalman"], ["kalman", "linear", "extended"]),
        (["--filter", "particle", "--smooth"], ["smoothed", "Gaussian"]),
        (["--set", "output.rate"], ["KEY=VALUE"]),
        (["--set", "output.speed=3"], ["output.speed"]),
        (["--until", "-3"], ["until"]),
        (["--truth", "vicon"], ["vicon"]),
        (["--require", "nonsense"], ["SCORE<=NUMBER"]),
        (["--set", f"output.rate={'9' * 5000}"], ["--set output.rate=999", "a TOML value"]),
        (["--set", f"output.rate={'[' * 3000}"], ["--set output.rate=[[[", "a TOML value"]),
        (["--set", f"output.rate={'9' * 400}"], ["output.rate", "found 999"]),
        (["--filter", f"gated:false_alarm={'9' * 400}"], ["false_alarm: found '999"]),
        (["--filter", NESTED], ["filters in filters", "at most 20"]),
    ],
    ids=lambda value: "_".join(value)[:40] if isinstance(value, list) else "",
)
def test_bad_options(arguments, expected, site, kedge):
    code, out, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", *arguments
    )
    assert code == 2, err
    assert "Traceback" not in err
    for part in expected:
        assert part in err, part
    assert max(map(len, err.splitlines())) < 600
    assert out == ""
    assert not (site / "out").exists()


def test_keys_of_lists_of_tables_are_named_with_their_line(tmp_path, kedge):
    text = (
        'extends = "yard"\n[[claims]]\ntext = "x"\nsource = "y"\nmeans = "z"\n'
        '[[claims]]\ntext = "x"\nsource = "y"\ntst = "extended.rmse.position < 1"\n'
        "[[quoted]]\nscore = 3\n[[expected]]\nbetwen = [1, 2]\n"
    )
    (tmp_path / "slips.toml").write_text(text)
    code, _, err = kedge("study", tmp_path / "slips.toml", "--runs", "2")
    assert code == 2
    assert "slips.toml:9: claims.1.tst: no key called 'tst' (did you mean 'test'?)" in err
    assert "slips.toml:11: quoted.0.score: found 3, expected a valid string" in err
    assert "slips.toml:13: expected.0.betwen: no key called 'betwen'" in err
    assert "claims.0" not in err


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--seed", "99999999999999999999"], "--seed"),
        (["--runs", "99999999999999999999"], "--runs"),
        (["--shard", f"{'9' * 5000}/1", "--out", "z"], "--shard: found '999"),
    ],
    ids=["seed", "runs", "shard"],
)
def test_numbers_that_are_too_large(options, expected, kedge):
    code, out, err = kedge("study", "yard", *options)
    assert (code, out) == (2, "")
    assert expected in err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_that_cannot_be_written(site, kedge):
    (site / "locked").mkdir(mode=0o500)
    code, _, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "locked" / "out"
    )
    assert code == 2
    assert "cannot be written" in err


def test_output_below_a_file(site, kedge):
    (site / "file").write_text("mine")
    code, _, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "file" / "out"
    )
    assert code == 2
    assert "file" in err
    assert (site / "file").read_text() == "mine"


def test_folder_of_somebody_else_is_left_alone(site, kedge):
    (site / "out").mkdir()
    (site / "out" / "thesis.txt").write_text("mine")
    code, _, err = kedge("estimate", site / "rig.toml", site / "log", "--out", site / "out")
    assert code == 2
    assert "not empty" in err
    assert (site / "out" / "thesis.txt").read_text() == "mine"
