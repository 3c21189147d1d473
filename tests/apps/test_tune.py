"""``kedge tune``: what it prints and leaves, and what it refuses."""

import json
import tomllib

import pytest

from kedge.apps.tune import warnings
from kedge.formats.results import as_toml


@pytest.fixture
def tuned(site, kedge):
    code, out, err = kedge(
        "tune", site / "rig.toml", site / "log", "--out", site / "out", "--starts", 2,
        "--parameters", "speed_noise,range_std", "--hold-out", 0.25,
    )  # fmt: skip
    assert code == 0, err
    return site, out, err, json.loads((site / "out" / "tune.json").read_text())


def test_it_leaves_what_it_promises(tuned):
    site, out, _, summary = tuned
    names = {path.name for path in (site / "out").iterdir()}
    assert names == {"kedge.json", "tune.json", "tuned.toml", "profile.svg", "profile.png"}
    rows = {row["key"]: row for row in summary["parameters"]}
    assert list(rows) == [
        "vehicle.parameters.speed_noise",
        "sensors.camera.parameters.range_std",
    ]
    assert all(row["found"] > 0 and row["start"] == 0.1 for row in rows.values())
    assert summary["criterion"] == "innovations"
    assert summary["tuned_until"] == pytest.approx(15.0)
    assert summary["loss"]["tuned"] < summary["loss"]["start"]
    assert summary["loss"]["judged"] == 30
    assert set(summary["scores"]) == {"start", "tuned", "tuned_ungated"}
    parts = summary["scores"]["tuned"]
    assert (parts["tuning"]["readings"], parts["held_out"]["readings"]) == (30, 10)
    assert {"rmse", "nees", "nis", "log_likelihood"} <= set(parts["held_out"])
    for key in rows:
        assert key in out
    assert "2 of 2 starts agree" in out
    assert any("without a gate" in note for note in summary["notes"])


def test_the_rig_it_leaves_holds_the_values_found(tuned, kedge):
    site, _, _, summary = tuned
    rig = tomllib.loads((site / "out" / "tuned.toml").read_text())
    found = [row["found"] for row in summary["parameters"]]
    assert rig["vehicle"]["parameters"]["speed_noise"] == found[0]
    assert rig["sensors"]["camera"]["parameters"] == {
        "range_std": found[1],
        "bearing_std": 0.02,
    }
    code, out, err = kedge(
        "estimate", site / "out" / "tuned.toml", site / "log", "--out", site / "again",
        "--json", "--no-report",
    )  # fmt: skip
    assert code == 0, err
    whole = json.loads(out)["filters"]["extended"]["rmse"]["position"] ** 2
    parts = [
        summary["scores"]["tuned"][part]["rmse"]["position"] for part in ("tuning", "held_out")
    ]
    assert whole == pytest.approx(0.75 * parts[0] ** 2 + 0.25 * parts[1] ** 2, rel=0.02)


def test_truth_is_judged_on_request(site, kedge):
    code, out, err = kedge(
        "tune", site / "rig.toml", site / "log", "--out", site / "out", "--starts", 1,
        "--parameters", "range_std", "--with-truth", "--json", "--no-report", "--hold-out", 0,
        "--require", "tuned.tuning.nees<=9",
    )  # fmt: skip
    assert code == 0, err
    summary = json.loads(out)
    assert summary["criterion"] == "truth"
    assert summary["loss"]["judged"] == 100
    assert "held_out" not in summary["scores"]["start"]
    assert not (site / "out" / "profile.svg").exists()


def test_what_became_worse_is_said():
    good = {"fused": 100, "rmse": {"position": 0.1, "heading": 0.1}}
    bad = {"fused": 40, "rmse": {"position": 0.3, "heading": 0.105}}
    scores = {"start": {"held_out": good}, "tuned": {"held_out": bad}}
    gates, error, advice = warnings(scores, with_truth=False)
    assert "held-out part" in gates
    assert "40 readings are fused, 100 were" in gates
    assert "rmse of position is 0.3, it was 0.1" in error
    assert "--with-truth" in advice
    assert warnings(scores, with_truth=True) == [gates, error]
    assert warnings({"start": {"held_out": good}, "tuned": {"held_out": good}}, False) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--parameters", "range_stdd"], ["no parameter called 'range_stdd'", "range_std"]),
        (["--parameters", "std,std"], ["no parameter called 'std'"]),
        (["--hold-out", "1"], ["--hold-out", "0.9"]),
        (["--bounds", "range_std=1"], ["--bounds", "KEY=LOW:HIGH"]),
        (["--bounds", "range_std=1:2"], ["range_std", "0.1", "between"]),
        (["--filter", "particle"], ["carries no Gaussian", "extended"]),
        (["--filter", "dead-reckoning"], ["fused no reading"]),
        (["--set", "vehicle.parameters.speed_noise=0", "--parameters", "speed_noise"],
         ["vehicle.parameters.speed_noise", "found 0", "--set"]),
        (["--until", "0"], ["until"]),
    ],
)  # fmt: skip
def test_what_cannot_be_tuned_is_refused(site, kedge, arguments, said):
    code, out, err = kedge(
        "tune", site / "rig.toml", site / "log", "--out", site / "out", *arguments
    )
    assert code == 2, out + err
    for text in said:
        assert text in err
    assert not (site / "out").exists()


def test_truth_that_is_not_there_cannot_be_judged(site, kedge):
    log = site / "log" / "log.toml"
    log.write_text(log.read_text().replace('truth = "truth"\n', ""))
    rig = site / "rig.toml"
    rig.write_text(rig.read_text().replace('from_truth = ["position", "heading"]\n', ""))
    code, _, err = kedge("tune", rig, site / "log", "--out", site / "out", "--with-truth")
    assert code == 2
    assert "the log has no truth" in err


def test_keys_that_are_no_bare_words_are_quoted():
    table = {"sensors": {"front camera": {"columns": {"range.m": "r"}, "rate": 2.0}}}
    assert tomllib.loads(as_toml(table)) == table
