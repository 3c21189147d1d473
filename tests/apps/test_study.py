"""``kedge study``: what it prints and leaves, and what it refuses."""

import csv
import json
import re

import pytest

from fixtures.studies import buoy_text
from kedge.apps.study_output import score_names, summary_of
from kedge.config.scenarios import load_scenario
from kedge.evaluation.record import record
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.filters.gaussian.kalman import Kalman
from kedge.formats.results import flatten
from kedge.studies.study import Study
from kedge.studies.trials import run_study

SCENARIO = buoy_text(
    duration=4.0,
    after="""
[published]
kalman = { rmse = 0.5, source = "nowhere" }

[windows]
late = [[2.0, 3.0]]

[[expected]]
score = "kalman.rmse.position"
between = [0.0, 9.0]

[[claims]]
text = "readings make it worse"
source = "a letter"
test = "kalman.score > dead-reckoning.score"
means = "they do not"
""",
)


@pytest.fixture
def buoy(tmp_path):
    path = tmp_path / "buoy.toml"
    path.write_text(SCENARIO)
    return path


def test_it_prints_scores_beside_what_was_published(buoy, kedge, tmp_path):
    out = tmp_path / "out"
    code, printed, err = kedge("study", buoy, "--out", out, "--no-report")
    assert code == 0, err
    assert sorted(path.name for path in out.iterdir()) == [
        "chunks", "kedge.json", "runs.csv", "study.json", "summary.json", "table.csv"
    ]  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())
    assert summary["runs"] == 3
    found = summary["filters"]["kalman"]
    # One line a filter: its name, its score, and what was published.
    (line,) = (line.split() for line in printed.splitlines() if line.startswith("kalman "))
    assert any(float(word) == pytest.approx(found["score"], rel=0.01)
               for word in line[1:] if word.replace(".", "").isdigit())  # fmt: skip
    assert "0.5" in line
    for words in ("a buoy", "nowhere", "kalman.rmse.position", "readings make it worse",
                  "a letter", "false"):  # fmt: skip
        assert words in printed
    assert found["score"] == found["rmse"]["position"] < 1
    assert list(found["windows"]) == ["late", "else"]
    assert summary["claims"][0]["verdict"] == "false"
    assert found["published"] == {"rmse": 0.5, "source": "nowhere"}
    assert found["score"] < summary["filters"]["dead-reckoning"]["score"]
    with (out / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == ["0", "1", "2"] * 2

    code, printed, err = kedge(
        "study", buoy, "--json", "--filters", "kalman", "--set", "scenario.runs=2",
        "--require", "kalman.score<=1e-9",
    )  # fmt: skip
    again = json.loads(printed)
    assert code == 3, err
    assert again["runs"] == 2
    assert list(again["filters"]) == ["kalman"]
    assert again["digest"] != summary["digest"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--runs", "0"], "runs: found 0, expected 1 or more"),
        (["--filters", "kalmn"], "no filters called 'kalmn' (did you mean 'kalman'"),
        (["--filters", "kalman,kalman"], "found a name twice"),
        (["--filters", ""], "found a name twice or none"),
        (["--filters", "ensemble:count=1"], "count is 1"),
        (["--seed", "-1"], "seed: found -1"),
        (["--set", "scenario.score=best"], "scenario.score: found 'best'"),
        (["--set", "scenario.duration"], "expected KEY=VALUE"),
        (["--set", "claims=[{text='a',source='b',test='c'}]"], "claims"),
        (["--set", "vehicle.model=unicycle"], "no field of the state called 'velocity'"),
        (["--set", "vehicle.model=unicycle", "--set", "prior.std={position=1.0,heading=0.1}",
          "--filters", "dead-reckoning,extended,kalman"],
         "filter 'kalman' cannot run here: the filter 'kalman' needs a linear model"),
        (["--set", "sensors.gnss.rates=3"], "(did you mean 'rate'"),
        (["--set", "senors.gnss.rate=3"], "(did you mean 'sensors'"),
        (["--require", "kalmn.score<=1"],
         "--require kalmn.score: no filter in this run called 'kalmn' (did you mean 'kalman'"),
        (["--require", "kalman.rmse.postion<=1"], "(did you mean 'kalman.rmse.position'"),
        (["--require", "kalman.windows.early.nees<=1"],
         "no score called 'kalman.windows.early.nees' (did you mean 'kalman.windows."),
        (["--require", "kalman.score=1"], "expected SCORE<=NUMBER"),
    ],
)  # fmt: skip
def test_bad_input(buoy, kedge, tmp_path, options, message):
    out = tmp_path / "out"
    code, printed, err = kedge("study", buoy, "--out", out, *options)
    said = [line for line in err.splitlines() if not line.startswith("[")]
    assert "simulating" not in err  # nothing is computed before all is known to be right
    assert "compiling" not in err
    assert (code, printed) == (2, "")
    assert message in said[0]
    assert not out.exists()


def test_an_unknown_scenario_is_told_the_nearest(kedge, tmp_path):
    code, printed, err = kedge("study", "yrd", "--out", tmp_path / "out")
    assert (code, printed) == (2, "")
    assert "'yrd'" in err
    assert "yard" in err
    assert not (tmp_path / "out").exists()


def test_a_cloud_that_collapsed_is_the_loudest_of_warnings(buoy, kedge, tmp_path):
    """Three particles span no four components: there is no NEES, which is no good news."""
    options = ["--filters", "kalman,particle:count=3", "--out", tmp_path / "out"]
    code, out, err = kedge("study", buoy, *options)
    assert code == 0, err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    collapsed = summary["filters"]["particle:count=3"]
    assert (collapsed["nees"], collapsed["failed"]) == (None, 0)
    assert collapsed["singular"] > 0.5  # the others have an inverse by rounding alone
    assert summary["filters"]["kalman"]["singular"] == 0.0
    share = f"{100 * collapsed['singular']:.0f} %"
    text = f"particle:count=3: no NEES: the covariance is singular in {share} of the steps."
    assert summary["warnings"][0] == text
    assert f"kedge: warning: {text}" in err
    assert "singular" in out
    page = (tmp_path / "out" / "report.html").read_text()
    assert text in page.replace("\u00a0", " ")
    code, _, err = kedge("study", buoy, *options[:2], "--require", "no warnings")
    assert code == 3
    assert "warnings is " in err


def test_a_gate_that_keeps_the_readings_out_is_a_warning(kedge, tmp_path):
    """The speed is 1 m/s wrong: a gate believes the filter rather than the camera."""
    file = tmp_path / "biased.toml"
    file.write_text(
        'extends = "yard"\n[faults.wheel]\non = "control"\nmodel = "bias"\n'
        'parameters = { value = 1.0, component = "speed" }\n'
    )
    gate = "gated:false_alarm=0.001,recovery=inf,inner=extended"
    code, _, err = kedge("study", file, "--filters", f"extended,{gate}", "--runs", 2, "--json")
    assert code == 0, err
    shares = re.findall(r"warning: (\S+): (\d+) % of the readings of camera were", err)
    assert [name for name, _ in shares] == [gate]
    assert int(shares[0][1]) > 30


def test_a_study_without_a_warning_can_be_required(buoy, kedge):
    options = ["--filters", "kalman", "--runs", "40", "--require", "no warnings"]
    code, _, err = kedge("study", buoy, *options)
    assert code == 0, err
    assert "warning" not in err


def test_every_score_it_leaves_can_be_required(buoy):
    setting = load_scenario(str(buoy), {})
    study = Study(setting.scenario, burn_in=1.0)
    filters = {"kalman": Kalman(), "dead-reckoning": DeadReckoning()}
    summary = summary_of(setting, study, run_study(study, filters, 2), 2)
    left = {k for k, v in flatten(record(summary.filters)) if not isinstance(v, str)}
    assert set(score_names(setting, study, list(filters))) == left
