"""``kedge tune`` over several logs, over blocks of one, and over horizons."""

import json
import shutil

import numpy as np
import pytest

from kedge.apps.tune_parts import growth


@pytest.fixture
def logs(site):
    """Three drives on the same circle, whose ranges scatter differently."""
    random, folders = np.random.default_rng(3), [site / "log"]
    for number in (2, 3):
        folders.append(site / f"log{number}")
        shutil.copytree(site / "log", folders[-1])
        camera = folders[-1] / "camera.csv"
        header, *rows = camera.read_text().splitlines()
        cells = [row.split(",") for row in rows]
        for row in cells:
            row[2] = str(float(row[2]) + random.normal(0, 0.1))
        camera.write_text("\n".join([header, *map(",".join, cells)]) + "\n")
    return folders


def tuned(site, kedge, *arguments):
    code, out, err = kedge(
        "tune", site / "rig.toml", *arguments, "--out", site / "out", "--starts", 1,
        "--parameters", "range_std", "--no-report",
    )  # fmt: skip
    assert code == 0, err
    return out, err, json.loads((site / "out" / "tune.json").read_text())


def test_each_log_is_left_out_and_scored_beside(site, kedge, logs):
    wrong = "sensors.camera.parameters.range_std=0.8"
    out, _, summary = tuned(site, kedge, *logs, "--set", wrong)
    assert list(summary["scores"]) == ["start", "tuned", "left_out"]
    assert summary["logs"] == {f"log_{n}": str(log) for n, log in enumerate(logs, start=1)}
    assert summary["tuned_until"] is None
    assert summary["loss"]["judged"] == 3 * 40
    verdict = summary["generalisation"]
    assert verdict["status"] == "holds"
    assert verdict["sentence"] in out
    assert len({part["sensors.camera.parameters.range_std"]
                for part in verdict["parts"].values()}) == 3  # fmt: skip
    for part in ("log_1", "log_2", "log_3"):
        start, on, apart = (column[part] for column in summary["scores"].values())
        assert on["readings"] == apart["readings"] == 40
        assert on["loss"] <= apart["loss"]
        assert on["rmse"]["position"] != apart["rmse"]["position"] != start["rmse"]["position"]
        assert 0 <= apart["coverage_95"]["position"] <= 1
        assert f"{part.replace('_', '-')} part (start -> tuned -> left out)" in out


def test_blocks_of_one_log_are_left_out(site, kedge):
    _, _, summary = tuned(site, kedge, site / "log", "--blocks", 4)
    assert list(summary["scores"]["left_out"]) == [f"block_{n}" for n in range(1, 5)]
    assert sum(part["readings"] for part in summary["scores"]["tuned"].values()) == 40
    assert "4 blocks" in summary["generalisation"]["sentence"]


def test_readings_are_predicted_over_horizons(site, kedge):
    out, _, summary = tuned(site, kedge, site / "log", "--horizons", "1,4", "--hold-out", 0)
    assert (summary["criterion"], summary["horizons"]) == ("horizons", [1.0, 4.0])
    # 40 readings twice a second, but for those in the first window of each horizon.
    assert summary["loss"]["judged"] == (40 - 1) + (40 - 7)
    assert "loss by reading and horizon" in out


def test_over_fit_is_a_warning_and_can_be_forbidden(site, kedge, logs):
    code, _, err = kedge(
        "tune", site / "rig.toml", *logs, "--out", site / "out", "--starts", 1, "--until", 2,
        "--no-report", "--require", "no warnings",
    )  # fmt: skip
    assert code == 3
    summary = json.loads((site / "out" / "tune.json").read_text())
    assert summary["generalisation"]["status"] in ("over-fit", "worse")
    assert f"warning: {summary['generalisation']['sentence']}" in err


@pytest.mark.parametrize(
    ("count", "arguments", "said"),
    [
        (1, ["--leave-one-out"], ["--leave-one-out", "found one log", "--blocks"]),
        (1, ["--blocks", "1"], ["--blocks", "found 1", "at least 2"]),
        (1, ["--blocks", "1000"], ["nothing to judge", "larger"]),
        (2, ["--blocks", "3"], ["--blocks", "found 2 logs", "expected one"]),
        (2, ["--hold-out", "0.3"], ["--hold-out", "several logs"]),
        (1, ["--blocks", "3", "--no-leave-one-out"], ["--blocks", "--no-leave-one-out"]),
        (1, ["--horizons", "1,11"], ["horizons", "found 11 s", "half", "10 s"]),
        (1, ["--horizons", "1,fast"], ["--horizons '1,fast'", "1,5,20"]),
        (1, ["--horizons", "-1"], ["--horizons '-1'", "above 0"]),
        (1, ["--horizons", ""], ["--horizons ''", "1,5,20"]),
        (1, ["--horizons", "1", "--with-truth"], ["horizons", "truth"]),
    ],
)
def test_what_contradicts_itself_is_refused(site, kedge, logs, count, arguments, said):
    code, out, err = kedge(
        "tune", site / "rig.toml", *logs[:count], "--out", site / "out", "--starts", 1,
        "--parameters", "range_std", *arguments,
    )  # fmt: skip
    assert code == 2, out + err
    assert err.count("kedge: ") == 1
    for text in said:
        assert text in err
    assert not (site / "out").exists()


def test_the_same_log_twice_is_refused(site, kedge, logs):
    code, _, err = kedge(
        "tune", site / "rig.toml", logs[0], logs[1], logs[0], "--out", site / "out"
    )
    assert code == 2
    assert f"{logs[0]}: found the same log as {logs[0]}" in err
    assert not (site / "out").exists()


def test_a_log_of_another_rig_is_refused_by_name(site, kedge, logs):
    table = logs[1] / "log.toml"
    table.write_text(table.read_text().replace("[sources.camera]", "[sources.sonar]"))
    (logs[1] / "camera.csv").rename(logs[1] / "sonar.csv")
    code, _, err = kedge("tune", site / "rig.toml", *logs, "--out", site / "out")
    assert code == 2
    assert str(logs[1]) in err
    assert "camera" in err
    assert not (site / "out").exists()


def test_errors_grow_by_the_root_of_their_squares_over_the_parts():
    def column(*errors):
        return {
            f"log_{n}": {"rmse": {"position": e, "speed": 1.0}} for n, e in enumerate(errors)
        }

    scores = {"start": column(3.0, 4.0), "left_out": column(6.0, 8.0)}
    assert growth(scores) == 2.0
    assert growth({"start": {"log_0": {}}, "left_out": {"log_0": {}}}) is None
