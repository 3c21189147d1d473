"""What programs call and what the commands do are the same code."""

import json

import pytest

import kedge
from fixtures.studies import buoy_text
from kedge import filters

SCENARIO = buoy_text(filters=["kalman"])


@pytest.fixture
def buoy(tmp_path):
    path = tmp_path / "buoy.toml"
    path.write_text(SCENARIO)
    return path


def test_a_study_finds_what_the_command_finds(buoy, request):
    done = kedge.study(buoy, runs=2, filters={"kalman": filters.Kalman()})
    command = request.getfixturevalue("kedge")
    code, printed, err = command("study", buoy, "--runs", 2, "--json")
    assert code == 0, err
    assert done.summary.about.digest == json.loads(printed)["digest"]
    assert {len(leaf) for leaf in done.results["kalman"].runs} == {2}
    table = done.to_pandas()
    assert table.loc["kalman", "score"] == done.scores["kalman"].score.value
    assert "kalman" in done._repr_html_()


def test_a_report_is_written_whole_and_only_once(buoy, tmp_path):
    pytest.importorskip("jinja2")
    changes = {"scenario.runs": 2}
    done = kedge.study(buoy, filters=["kalman", "dead-reckoning"], settings=changes)
    page = done.report(tmp_path / "out")
    assert page == tmp_path / "out" / "report.html"
    assert {"summary.json", "table.csv", "runs.csv", "report.html"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("not to be lost")
    with pytest.raises(kedge.KedgeError, match="notes"):
        done.report(tmp_path / "notes")
    assert (tmp_path / "notes" / "mine.txt").exists()


def test_tuning_finds_the_noise_of_the_sensor(site):
    rig, log = kedge.load(site / "rig.toml", site / "log")
    tuned = kedge.tune(rig, log, parameters=["range_std"], search=kedge.Search(starts=1))
    assert 0.05 < float(tuned.values[0]) < 0.2  # drawn with 0.1
    assert float(tuned.rig(rig).sensors[0].sensor.range_std) == pytest.approx(tuned.values[0])
    with pytest.raises(kedge.DataError, match="has no truth"):
        kedge.tune(rig, log._replace(truth=None), with_truth=True)


def test_bad_input_is_refused_as_by_the_command(buoy):
    with pytest.raises(kedge.UnknownName, match="did you mean 'kalman'"):
        kedge.study(buoy, filters=["kalmn"])
    with pytest.raises(kedge.ConfigError, match="runs: found 0"):
        kedge.study(buoy, runs=0)
