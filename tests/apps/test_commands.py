"""What the commands promise to scripts."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest


@pytest.fixture
def done(site, kedge):
    """A finished estimate, with what it printed."""
    code, out, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--smooth", "--json"
    )
    assert code == 0, err
    return site / "out", json.loads(out)


def test_estimate_leaves_what_it_promises(done):
    folder, printed = done
    names = {p.name for p in folder.iterdir()}
    assert {"summary.json", "table.csv", "report.html", "figures"} <= names
    assert {"estimate_extended.csv", "estimate_extended.tum"} <= names
    assert {"verdicts_extended_camera.csv", "estimate_extended+smoother.csv"} <= names
    assert {p.suffix for p in (folder / "figures").iterdir()} == {".png", ".svg"}

    summary = json.loads((folder / "summary.json").read_text())
    assert summary == printed
    scores = summary["filters"]["extended"]
    assert {"command", "version", "seed", "runs", "filters", "verdicts", "digest"} <= set(
        summary
    )
    assert {"position", "position_x", "position_y", "heading"} <= set(scores["rmse"])
    assert 0 < scores["rmse"]["position"] < 0.3
    low, high = scores["rmse_ci"]["position"]
    assert low <= scores["rmse"]["position"] <= high
    counts = summary["verdicts"]["extended"]["camera"]
    with (folder / "verdicts_extended_camera.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(counts.values()) == len(rows) == 40
    assert sum(row["verdict"] == "FUSED" for row in rows) == counts["FUSED"]
    assert (
        summary["filters"]["extended+smoother"]["rmse"]["position"] < scores["rmse"]["position"]
    )


def test_estimate_csv_holds_the_outputs_with_exact_stamps(done):
    folder, _ = done
    with (folder / "estimate_extended.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 100
    assert [int(row["stamp_ns"]) for row in rows[:3]] == [200_000_000, 400_000_000, 600_000_000]
    assert [float(row["time_s"]) for row in rows[:3]] == [0.2, 0.4, 0.6]
    assert set(rows[0]) == {
        "stamp_ns", "time_s", "position_x", "position_y", "heading",
        "position_x_std", "position_y_std", "heading_std",
    }  # fmt: skip
    tum = (folder / "estimate_extended.tum").read_text().splitlines()
    assert len([text for text in tum if not text.startswith("#")]) == 100


def test_the_same_log_gives_the_same_bytes(site, kedge):
    for name in ("one", "two"):
        code, _, err = kedge("estimate", site / "rig.toml", site / "log", "--out", site / name)
        assert code == 0, err
    for file in ("estimate.csv", "estimate.tum", "verdicts_camera.csv"):
        assert (site / "one" / file).read_bytes() == (site / "two" / file).read_bytes()
    digests = [
        json.loads((site / name / "summary.json").read_text())["digest"]
        for name in ("one", "two")
    ]
    assert digests[0] == digests[1]


def test_digest_follows_input_configuration_and_result(site, kedge):
    def digest(*more):
        code, out, err = kedge(
            "estimate",
            site / "rig.toml",
            site / "log",
            "--out",
            site / "out",
            "--json",
            "--no-report",
            *more,
        )
        assert code == 0, err
        return json.loads(out)["digest"]

    base = digest()
    changed = digest("--set", "sensors.camera.parameters.range_std=0.2")
    assert changed["inputs"] == base["inputs"]
    assert changed["configuration"] != base["configuration"]
    assert changed["result"] != base["result"]
    camera = site / "log" / "camera.csv"
    camera.write_text(camera.read_text() + "20.05,a,5.0,0.5\n")
    assert digest()["inputs"] != base["inputs"]


def test_a_target_that_is_not_on_the_map_is_a_verdict(site, kedge):
    camera = site / "log" / "camera.csv"
    camera.write_text(camera.read_text() + "20.05,pillar,5.0,0.5\n20.06,a,,\n20.07,a,,0.5\n")
    code, out, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--json",
        "--no-report",
    )  # fmt: skip
    assert code == 0, err
    counts = json.loads(out)["verdicts"]["extended"]["camera"]
    assert counts["UNKNOWN_TARGET"] == 1
    assert counts["NOT_FINITE"] == 1


def test_a_cloud_that_collapsed_is_warned_of(site, kedge):
    code, out, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--filter", "particle:count=2", "--out",
        site / "out", "--no-report", "--json", "--require", "no warnings",
    )  # fmt: skip
    assert code == 3, err
    summary = json.loads(out)
    assert summary["filters"]["particle:count=2"]["nees"] is None
    assert summary["filters"]["particle:count=2"]["singular"] > 0.5
    text = "particle:count=2: no NEES: the covariance is singular in"
    assert summary["warnings"][0].startswith(text)
    assert f"kedge: warning: {text}" in err


@pytest.mark.parametrize("command", [["estimate"], ["compare", "--filters", "extended"]])
def test_without_what_draws_the_report_nothing_is_computed(command, site, kedge, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    name, *more = command
    code, _, err = kedge(name, site / "rig.toml", site / "log", "--out", site / "out", *more)
    assert code == 2
    assert err.splitlines()[-1].startswith("kedge: a report needs matplotlib")
    assert "scores" not in err
    assert not (site / "out").exists()


def test_compare_puts_filters_side_by_side(site, kedge):
    names = "dead-reckoning,extended,unscented,ensemble:count=60,extended+smoother"
    code, out, err = kedge(
        "compare", site / "rig.toml", site / "log", "--filters", names, "--out", site / "out",
        "--no-report",
    )  # fmt: skip
    assert code == 0, err
    summary = json.loads((site / "out" / "summary.json").read_text())
    assert list(summary["filters"]) == names.split(",")
    assert summary["filters"]["dead-reckoning"]["ratio_to_baseline"] == 1
    assert summary["filters"]["extended"]["ratio_to_baseline"] < 1
    assert summary["verdicts"]["dead-reckoning"]["camera"] == {"DROPPED": 40}
    assert "ensemble:count=60" in out
    with (site / "out" / "table.csv").open() as file:
        assert [row["filter"] for row in csv.DictReader(file)] == names.split(",")


def test_without_truth_the_console_says_what_the_filter_believes(site, kedge):
    code, out, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--truth", "none",
        "--set", "prior.from_truth=[]", "--set", "prior.mean={}", "--no-report",
    )  # fmt: skip
    assert code == 0, err
    scores = json.loads((site / "out" / "summary.json").read_text())["filters"]["extended"]
    with (site / "out" / "estimate.csv").open() as file:
        rows = list(csv.DictReader(file))
    variance = [
        float(row["position_x_std"]) ** 2 + float(row["position_y_std"]) ** 2 for row in rows
    ]
    position = float(np.median(np.sqrt(variance)))
    heading = float(np.median([float(row["heading_std"]) for row in rows]))
    assert scores["std"] == pytest.approx({"position": position, "heading": heading})
    head, values = (line.split() for line in out.splitlines()[:2])
    assert head[:4] == ["filter", "position", "1-sigma", "m"]
    assert values[1:3] == [f"{position:.3g}", f"{np.degrees(heading):.3g}"]
    camera = scores["sensors"]["camera"]
    row = next(line.split() for line in out.splitlines() if "camera" in line)
    share = f"{camera['fused']:.1%}"
    assert row[:4] == ["extended", "camera", "40", share]
    assert row[4:6] == [f"{camera['nis']:.3g}", "2"]


def test_a_sensor_that_is_hardly_used_is_told_with_the_reasons(site, kedge):
    camera = site / "log" / "camera.csv"
    lines = camera.read_text().splitlines()
    # Every second reading is of a post that the map does not know.
    strange = [text.replace(",b,", ",pillar,") for text in lines]
    camera.write_text("\n".join(strange) + "\n")
    options = (
        "compare", site / "rig.toml", site / "log", "--out", site / "out", "--no-report",
        "--filters", "dead-reckoning,extended", "--json", "--require",
    )  # fmt: skip
    code, out, err = kedge(*options, "camera.fused>=0.9")
    assert code == 3
    assert "extended.sensors.camera.fused is 0." in err
    summary = json.loads(out)
    counts = summary["verdicts"]["extended"]["camera"]
    fused = summary["filters"]["extended"]["sensors"]["camera"]["fused"]
    assert fused == counts["FUSED"] / 40 <= 0.5
    assert counts["UNKNOWN_TARGET"] == 20
    text = next(text for text in summary["warnings"] if "camera" in text)
    assert text.startswith(f"extended: only {100 * fused:.0f} % of the 40 readings of camera")
    assert "20 unknown target" in text
    assert text in err
    code, _, err = kedge(*options, "camera.fused>=0.1")
    assert code == 0, err
    code, _, err = kedge(*options, "camra.fused>=0.1")
    assert code == 2


def test_truth_none_scores_nothing(site, kedge):
    code, out, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--json",
        "--truth", "none", "--no-report",
    )  # fmt: skip
    assert code == 0, err
    scores = json.loads(out)["filters"]["extended"]
    assert "rmse" not in scores
    assert scores["sensors"]["camera"]["nis_dof"] == 2


def test_a_threshold_that_is_missed_is_exit_3(site, kedge):
    command = [
        "estimate",
        site / "rig.toml",
        site / "log",
        "--out",
        site / "out",
        "--no-report",
    ]
    code, _, err = kedge(*command, "--require", "extended.rmse.position<=0.0001")
    assert code == 3
    assert "extended.rmse.position" in err
    assert (site / "out" / "summary.json").exists()
    code, _, _ = kedge(*command, "--require", "extended.coverage_95.position>=0.5")
    assert code == 0


def test_results_are_replaced_as_a_whole(done, site, kedge):
    (site / "out" / "notes.txt").write_text("not kedge's")
    code, _, _ = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--no-report"
    )
    assert code == 0
    assert not (site / "out" / "report.html").exists()
    assert (site / "out" / "notes.txt").read_text() == "not kedge's"


def test_list_names_every_family(kedge):
    code, out, _ = kedge("list", "--json")
    found = json.loads(out)
    assert code == 0
    models = {"vehicles", "sensors", "filters", "worlds", "routes", "faults"}
    assert set(found) == models | {"rigs", "scenarios", "datasets", "readers"}
    assert found["worlds"]["omnidirectional"]["parameters"]["arm"]["unit"] == "m"
    assert found["faults"]["delay"]["parameters"]["delay"] == {"default": 0.1, "unit": "s"}
    assert found["vehicles"]["unicycle"]["state"] == {
        "position_x": "m", "position_y": "m", "heading": "rad",
    }  # fmt: skip
    assert "mrclam" in found["rigs"]
    code, out, _ = kedge("list", "filters")
    assert code == 0
    assert "extended" in out
    code, _, err = kedge("list", "filter")
    assert code == 2
    assert "filters" in err


def test_config_schema_is_a_schema(kedge):
    import jsonschema

    code, out, _ = kedge("config", "schema")
    assert code == 0
    jsonschema.Draft202012Validator.check_schema(json.loads(out))


def test_datasets_say_where_they_are(kedge, monkeypatch, tmp_path):
    monkeypatch.setenv("KEDGE_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    code, _, err = kedge("datasets", "path", "mrclam")
    assert code == 2
    assert "kedge datasets fetch mrclam" in err
    place = tmp_path / "mrclam" / "MRCLAM_Dataset7"
    place.mkdir(parents=True)
    code, out, _ = kedge("datasets", "path", "mrclam")
    assert code == 0
    assert out.strip() == str(place)
    code, _, err = kedge("datasets", "path", "mrclan")
    assert code == 2
    assert "mrclam" in err


def test_the_copy_at_hand_is_the_one_that_is_known(data):
    from kedge.datasets.fetch import locate, verify

    folder = locate("mrclam")
    assert folder is not None
    verify("mrclam", folder)


def test_help_imports_nothing_heavy():
    """What keeps ``--help`` quick; `make bench` measures how quick it is."""
    program = (
        "import sys; sys.argv = ['kedge', '--help']\n"
        "from kedge.apps.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert end.code == 0\n"
        "heavy = {'jax', 'numpy', 'scipy', 'pandas', 'matplotlib', 'pydantic', 'equinox'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert b"estimate" in found.stdout
    assert found.stdout.decode().splitlines()[-1] == "[]"
