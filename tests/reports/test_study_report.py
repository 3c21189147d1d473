"""The report of a study, and what its figures are made of."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from fixtures.studies import buoy_text
from kedge.apps.study_output import content_of, summary_of
from kedge.config.filters import build_filter
from kedge.config.scenarios import load_scenario
from kedge.core.errors import KedgeError
from kedge.reports import style
from kedge.reports.page import require_studio
from kedge.reports.study_cost import plot_cost
from kedge.reports.study_curves import BINS, coarse, nis_curve
from kedge.reports.study_lines import (
    featured,
    fit,
    lines,
    members,
    panels,
    series,
    short,
    study_looks,
)
from kedge.reports.study_report import tracks, write_study_report
from kedge.studies.scores import Tally, TimeSums
from kedge.studies.study import Study
from kedge.studies.trials import Trials

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

BUOY = 'errata = ["Table 4 <is> wrong"]\n' + buoy_text(
    title="A buoy & a boat",
    duration=12.0,
    burn_in=2.0,
    filters=["kalman", "extended", "dead-reckoning", "ensemble:count=8", "ensemble:count=16"],
    featured=["ensemble:count=8", "kalman"],
    panels=["ensemble:count=16"],
    sensor='model = "position-velocity"\nrate = 2.0',
    after="""
[published."ensemble:count=16"]
rmse = 0.489
source = "Table 3"

[windows]
corner = [[3.0, 5.0]]

[[expected]]
score = "kalman.rmse.position"
between = [0.0, 9.0]

[[expected]]
score = "kalman.rmse.position"
between = [8.0, 9.0]

[[claims]]
text = "Readings make it worse"
source = "a letter"
test = "kalman.score > dead-reckoning.score"
means = "They do not"
""",
)


def study_content(setting, runs, chunk=16):
    about = setting.config.scenario
    study = study_of(setting)
    trials = Trials(study, {n: build_filter(n) for n in about.filters}, runs, chunk)
    tally = Tally(about.filters)
    for number in trials.chunks:
        tally.add(trials.part(number))
    results = tally.results()
    for place, name in enumerate(results):  # the same in every run of this test
        results[name] = results[name]._replace(seconds=0.1 * (place + 1), compile_seconds=1.0)
    summary = summary_of(setting, study, results, runs)
    about = replace(summary.about, arguments=("study", "buoy"))
    summary = replace(summary, about=about)
    return content_of(study, tally, summary)


def study_of(setting):
    about = setting.config.scenario
    how = about.burn_in, about.score, about.start
    return Study(setting.scenario, *how, windows=setting.config.windows)


@pytest.fixture(scope="module")
def buoy(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "buoy.toml"
    path.write_text(BUOY)
    return study_content(load_scenario(str(path), {}), 5)


@pytest.fixture(scope="module")
def written(buoy, tmp_path_factory):
    return write_study_report(tmp_path_factory.mktemp("report"), buoy)


@pytest.fixture(scope="module")
def page(written, reader):
    return reader(written.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def said(page):
    return " ".join(" ".join(page.said).split()).replace("\u00a0", " ")


def test_it_is_one_well_formed_file_without_requests(written, page):
    text = written.read_text(encoding="utf-8")
    assert "http" not in text
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    targets = [v[1:] for _, n, v in page.attributes if n == "href"]
    assert set(targets) <= set(page.ids)
    assert "A buoy &amp; a boat" in text
    assert "Table 4 &lt;is&gt; wrong" in text
    assert not re.search(r"\b(nan|NaN|inf|None)\b", " ".join(page.said))


def test_each_section_is_there(page):
    names = ["scores", "claims", "track", "errors", "consistency", "members", "filters",
             "configuration"]  # fmt: skip
    assert sorted(page.sections) == sorted(f"section-{name}" for name in names)


def test_every_score_claim_and_source_is_on_the_page(said, buoy):
    for name, scores in buoy.summary.filters.items():
        assert name in said
        assert style.measured(scores.score.value, scores.score[1:])[0] in said, name
    assert [claim.verdict for claim in buoy.summary.claims] == ["false"]
    missed = [one.score for one in buoy.summary.expected if one.verdict == "false"]
    assert missed == ["kalman.rmse.position"]
    claim = buoy.summary.claims[0]
    for words in (claim.text, claim.means, claim.verdict, *missed, "corner", "0.489 m",
                  "Table 3", buoy.summary.about.digest["result"]):  # fmt: skip
        assert words in said


def test_figures_lie_beside_it(written):
    names = {path.stem for path in (written.parent / "figures").glob("*.svg")}
    assert names == {path.stem for path in (written.parent / "figures").glob("*.png")}
    assert names == {"scores", "map", "position-x", "position-y", "error-over-time", "nees",
                     "nis", "members", "cost", "panels-ensemble-count-16"}  # fmt: skip


def test_filters_that_agree_are_drawn_as_one(written):
    text = (written.parent / "figures" / "error-over-time.svg").read_text()
    assert "kalman = extended" in text
    assert "ensemble:count=16" in text


def test_filters_that_are_beaten_in_both_are_off_the_front(buoy):
    """Their seconds rise in order here; extended is as accurate as kalman, which is faster."""
    filters = buoy.summary.filters
    for name, row in filters.items():
        worse = [
            other
            for other in filters.values()
            if other.seconds_per_run < row.seconds_per_run
            and other.score.value <= row.score.value
        ]
        assert row.dominated_by == len(worse), name
    ax = plot_cost(filters, "error (m)")
    (x, y) = ax.lines[0].get_data()
    front = [n for n, row in filters.items() if not row.dominated_by]
    assert "kalman" in front
    assert len(x) == len(front) < len(filters)
    assert (np.diff(x) > 0).all()
    assert (np.diff(y) < 0).all()


def test_the_same_content_gives_the_same_bytes(written, buoy, tmp_path):
    again = write_study_report(tmp_path, buoy)
    for path in written.parent.rglob("*.*"):
        assert (
            path.read_bytes() == (again.parent / path.relative_to(written.parent)).read_bytes()
        )


def test_a_missing_extra_is_named_before_anything_is_computed(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(KedgeError, match=r"pip install 'kedge-nav\[studio\]'"):
        require_studio()


def test_the_first_run_is_that_of_the_study(buoy):
    position, velocity = tracks(buoy)
    assert (position.name, velocity.name) == ("position", "velocity")
    assert position.truth.shape == position.estimates["kalman"].shape == (24, 2)
    assert list(position.estimates) == ["ensemble:count=8", "kalman"]  # as the scenario says
    seen = position.seen[0]
    assert seen.values.shape == (24, 2)
    # Readings every 0.5 s with 0.5 m of noise, of the truth at their own times.
    off = seen.values - position.truth
    np.testing.assert_array_equal(seen.time, position.time)
    assert 0.3 < np.sqrt(np.mean(off**2)) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("runs", [1, 3])
def test_a_state_without_a_position(tmp_path, reader, runs):
    changes = {
        "scenario.duration": "20.0",
        "scenario.burn_in": "5.0",
        "scenario.filters": '["extended", "ensemble:count=10"]',
    }
    setting = load_scenario("lorenz63", changes)
    text = write_study_report(tmp_path, study_content(setting, runs)).read_text()
    page = reader(text)
    assert "section-track" in page.sections
    assert (tmp_path / "figures" / "values-x.svg").is_file()
    assert not (tmp_path / "figures" / "map.svg").exists()
    assert not re.search(r"\b(nan|NaN|inf|None)\b", " ".join(page.said))


NAMES = ["kalman", "extended", "ensemble:count=20", "ensemble:count=100,inflation=1.01",
         "ensemble:count=100", "etkf:rotation=true,count=8"]  # fmt: skip


def test_members_are_read_off_names():
    found = {name: members(name) for name in NAMES}
    assert found == {
        "kalman": None,
        "extended": None,
        "ensemble:count=20": ("ensemble", 20),
        "ensemble:count=100,inflation=1.01": ("ensemble:inflation=1.01", 100),
        "ensemble:count=100": ("ensemble", 100),
        "etkf:rotation=true,count=8": ("etkf:rotation=true", 8),
    }
    assert series(NAMES) == {"ensemble": ["ensemble:count=20", "ensemble:count=100"]}


def test_a_family_shares_a_colour_and_grows_darker_with_its_members():
    looks = study_looks([*NAMES, "dead-reckoning"])
    ensembles = [looks[name] for name in (NAMES[2], NAMES[3], NAMES[4])]
    assert len({look.role for look in ensembles}) == 1
    assert ensembles[0].alpha < ensembles[2].alpha
    singles = [looks["kalman"], looks["extended"], looks["etkf:rotation=true,count=8"]]
    assert len({look.role for look in [*singles, ensembles[0]]}) == 4
    assert looks["dead-reckoning"].role == "dead-reckoning"


def test_curves_that_agree_share_a_line_and_a_panel():
    curve = np.linspace(1.0, 2.0, 5)
    curves = {"kalman": curve, "extended": curve * (1 + 1e-9), "unscented": curve * 1.01}
    found = lines(curves)
    assert [line.label for line in found] == ["kalman = extended", "unscented"]
    assert [panel.lines for panel in panels(found)] == [found]
    many = {f"ensemble:count={n}": curve * n for n in (2, 3, 4, 5, 6, 7, 8)} | curves
    split = panels(lines(many))
    assert [panel.title for panel in split] == ["ensemble", "single"] or [
        panel.title for panel in split
    ] == ["single", "ensemble"]
    for panel in split:
        assert "kalman" in panel.lines[0].names
    ensemble = next(panel for panel in split if panel.title == "ensemble")
    assert short(ensemble.lines[1], ensemble) == "N = 2"
    assert featured(many, ["unscented", "nobody"]) == ["unscented"]
    assert featured(many) == ["kalman", "extended", "unscented", "ensemble:count=8"] or set(
        featured(many)
    ) == {"kalman", "extended", "unscented", "ensemble:count=8"}


def test_long_labels_are_broken_between_options():
    text = "N = 10, inflation=1.02, rotation=true"
    assert fit(text, 24) == "N = 10, inflation=1.02,\nrotation=true"
    assert fit(text, 99) == text


@pytest.mark.parametrize("count", [3, BINS, BINS + 1, 1000])
def test_coarse_curves_keep_their_mean(count):
    values = np.random.default_rng(1).normal(size=count) ** 2
    time, kept = coarse(np.arange(count) / 10, values)
    assert len(kept) == len(time) == min(count, BINS)
    assert time[-1] == (count - 1) / 10
    if count % len(kept) == 0:
        np.testing.assert_allclose(kept.mean(), values.mean(), rtol=1e-12)
    assert values.min() <= kept.min() <= kept.max() <= values.max()


def test_a_right_filter_keeps_the_bounds_of_nis(buoy):
    runs, readings, dof = 50, 4000, 2.0
    random = np.random.default_rng(2)
    total = random.chisquare(dof, size=(readings, runs)).sum(axis=1)
    count = np.full(readings, float(runs))
    sums = TimeSums(jnp.asarray(50.0), count[:, None], count, total, count, dof * count)
    time = np.arange(1, readings + 1) / 10
    none = np.zeros(readings, int)
    plan = buoy.study.plan._replace(sensor=none, sensed_time=time, time=time)
    found = nis_curve(plan, sums, 0)
    inside = np.mean((found.nis >= found.low) & (found.nis <= found.high))
    assert len(found.nis) == BINS
    assert 0.90 < inside < 0.99  # 95 % of 200, give or take three deviations
    np.testing.assert_allclose(found.nis.mean(), total.sum() / (dof * runs * readings))
    assert len(nis_curve(plan, sums, 1).nis) == 0
