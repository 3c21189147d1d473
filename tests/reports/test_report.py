import re
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core import registry
from kedge.core.beliefs import Gaussian
from kedge.core.errors import DataError, KedgeError
from kedge.core.manifolds import space
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.smoother import smooth
from kedge.evaluation.score import score
from kedge.reports import style
from kedge.reports.drawing import without_fused
from kedge.reports.report import ReportContent, write_report
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")


def content(vehicle, sensors, filters, truth=True, spoil=False):
    vehicle = registry.vehicles.get(vehicle)()
    installed = tuple(
        Installation(name, registry.sensors.get(name)(), gate=gate)
        for name, gate in sensors.items()
    )
    start = vehicle.start()
    rig = Rig(vehicle, installed, Gaussian(start, 0.01 * np.eye(space(start).size)))
    recording, known = record(Scenario(rig, duration=20.0), jax.random.key(1))
    if spoil:
        readings = recording.log.readings[0]
        measured = jax.tree.map(np.array, readings.measurement)
        measured.range[5], measured.bearing[7], measured.range[11] = np.nan, np.nan, np.inf
        measured.range[20:30] += 50.0
        target = np.array(readings.target)
        target[12:15] = -1
        spoilt = readings._replace(
            measurement=jax.tree.map(jnp.asarray, measured), target=jnp.asarray(target)
        )
        sensor = np.array(recording.log.schedule.sensor)
        time = np.asarray(recording.log.schedule.time)
        sensor[(time > 5) & (time < 17)] = -1  # nothing is seen for a while
        schedule = recording.log.schedule._replace(sensor=jnp.asarray(sensor))
        log = recording.log._replace(schedule=schedule, readings=(spoilt,))
        recording = recording._replace(log=log)
    runs = []
    for name in filters:
        tool = registry.filters.get(name.split("+")[0])()
        estimates = (
            smooth(tool, rig, recording.log)[1]
            if "+smooth" in name
            else estimate(tool, rig, recording.log)
        )
        runs.append(score(name, estimates, recording, rig, known if truth else None))
        runs[-1] = runs[-1]._replace(scores=replace(runs[-1].scores, seconds=0.01))
    return ReportContent(
        "A drive <with> landmarks",
        runs,
        recording,
        rig,
        known if truth else None,
        {"landmarks": ("N<1>", "E&2", "S3")},
        '[vehicle]\nmodel = "unicycle"  # <b>',
        {"kedge": "0.1.0", "seed": "1", "digest": "sha256:00", "command": "kedge demo"},
        ["odometry: 2 rows were left out"],
    )


@pytest.fixture(scope="module")
def drive():
    filters = ["dead-reckoning", "extended", "extended+smooth"]
    return content("unicycle", {"landmarks": 0.01}, filters, spoil=True)


@pytest.fixture(scope="module")
def written(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    return write_report(folder, drive)


@pytest.fixture(scope="module")
def page(written, reader):
    return reader(written.read_text(encoding="utf-8"))


def test_it_is_one_file_without_requests(written, page):
    text = written.read_text(encoding="utf-8")
    assert "http" not in text
    assert "@import" not in text
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    for _, name, value in page.attributes:
        if name in ("href", "xlink:href", "src"):
            assert value.startswith("#")
    assert len(text) < 3_000_000


def test_it_is_well_formed(page):
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    targets = [v[1:] for _, n, v in page.attributes if n == "href"]
    clips = re.findall(r"url\(#([^)]+)\)", " ".join(v or "" for _, _, v in page.attributes))
    assert set(targets) | set(clips) <= set(page.ids)
    labels = {v for _, n, v in page.attributes if n == "aria-labelledby"}
    assert labels <= set(page.ids)


def test_each_section_is_there(page):
    expected = ["map", "errors", "consistency", "verdicts", "filters", "configuration"]
    assert sorted(page.sections) == sorted(f"section-{name}" for name in expected)


def test_the_figures_and_faults_of_the_run_are_on_the_page(page, drive):
    said = " ".join(" ".join(page.said).split()).replace("\u00a0", " ")
    for run in drive.runs:
        value, *ends = run.scores.rmse["position"]
        error = style.measured(value, ends)
        assert f"{error[0]} m" in said, run.name
    extended = drive.runs[1].scores
    assert style.percent(extended.coverage_95["position"]).replace("\u00a0", " ") in said
    for words in ("sha256:00", "kedge demo", "odometry: 2 rows", "unknown target", "E&2"):
        assert words in said
    begin, end = max(without_fused(drive.runs[1]), key=lambda gap: gap[1] - gap[0])
    assert f"{end - begin:.0f} s" in said


def test_text_of_others_is_escaped(written, page):
    assert "b" not in page.tags
    assert "A drive &lt;with&gt; landmarks" in written.read_text(encoding="utf-8")


def test_nothing_unknown_is_printed(page):
    values = " ".join(v or "" for _, _, v in page.attributes)
    assert not re.search(r"\b(nan|NaN|inf|None)\b", " ".join(page.said) + values)


def test_figures_lie_beside_it(written):
    names = {path.stem for path in (written.parent / "figures").glob("*.svg")}
    assert names == {path.stem for path in (written.parent / "figures").glob("*.png")}
    assert {"map", "distance", "errors-2", "nees", "nis", "innovations", "verdicts"} <= names
    for path in (written.parent / "figures").glob("*.svg"):
        assert path.stat().st_size < 400_000


def test_colours_follow_the_screen(written):
    text = written.read_text(encoding="utf-8")
    pictures = "".join(re.findall(r"<svg.*?</svg>", text, re.DOTALL))
    assert "var(--ink)" in pictures
    assert not {light for light, _ in style.PALETTE.values()} & set(
        re.findall(r"#[0-9a-f]{6}", pictures)
    )
    assert "prefers-color-scheme: dark" in text


def test_the_same_content_gives_the_same_bytes(written, drive, tmp_path):
    again = write_report(tmp_path, drive)
    for path in written.parent.rglob("*.*"):
        other = again.parent / path.relative_to(written.parent)
        assert path.read_bytes() == other.read_bytes(), path.name


@pytest.mark.parametrize(
    ("vehicle", "sensors", "truth", "absent"),
    [
        ("constant-velocity", {"gnss": 0.01, "velocity": None}, True, ["states"]),
        ("constant-velocity", {"gnss": None}, False, ["errors"]),
        pytest.param("strapdown", {"gnss3": None}, True, ["states"], marks=pytest.mark.slow),
        pytest.param("unicycle", {}, True, ["verdicts", "states"], marks=pytest.mark.slow),
        ("unicycle", {}, False, ["errors", "consistency", "verdicts"]),
    ],
)
def test_it_leaves_out_what_a_log_has_not(vehicle, sensors, truth, absent, tmp_path, reader):
    text = write_report(tmp_path, content(vehicle, sensors, ["extended"], truth)).read_text()
    page = reader(text)
    every = {"map", "errors", "states", "consistency", "verdicts", "filters", "configuration"}
    assert set(page.sections) == {f"section-{name}" for name in every - set(absent)}
    assert not re.search(r"\b(nan|NaN|inf|None)\b", " ".join(page.said))
    assert ("heading" in text) == (vehicle in ("unicycle", "strapdown"))


def test_without_a_run_nothing_is_written(drive, tmp_path):
    with pytest.raises(DataError, match="needs a run"):
        write_report(tmp_path / "out", drive._replace(runs=[]))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["jinja2", "matplotlib"])
def test_a_missing_extra_is_named(name, drive, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(KedgeError, match=rf"needs {name}.*pip install 'kedge-nav\[studio\]'"):
        write_report(tmp_path / "out", drive)
    assert not (tmp_path / "out").exists()
