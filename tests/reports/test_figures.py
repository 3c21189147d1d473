import jax
import numpy as np
import pytest

from kedge.core import registry
from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.score import score
from kedge.reports import diagnostics, figures, maps, style
from kedge.reports.drawing import ellipses, envelope, thinned
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record

pytest.importorskip("matplotlib")

TARGETS = {"camera": (("a", "b"), np.array([[5.0, 30.0], [-20.0, 5.0]]))}


@pytest.fixture(scope="module")
def problem():
    vehicle = registry.vehicles.get("unicycle")()
    camera = Installation("camera", registry.sensors.get("landmarks")(), gate=0.01)
    start = vehicle.start()
    rig = Rig(vehicle, (camera,), Gaussian(start, 0.01 * np.eye(space(start).size)))
    recording, truth = record(Scenario(rig, duration=20.0), jax.random.key(1))
    runs = []
    for name in ("dead-reckoning", "extended"):
        estimates = estimate(registry.filters.get(name)(), rig, recording.log)
        runs.append(score(name, estimates, recording, rig, truth))
    return rig, recording, truth, runs


def draw(name, problem):
    rig, recording, truth, runs = problem
    of_sensor = (runs[1], recording, rig, "camera")
    found = {
        "map": lambda: maps.plot_map(runs, truth, TARGETS),
        "maps": lambda: maps.plot_maps(runs, truth, TARGETS),
        "distance": lambda: figures.plot_distance(runs),
        "errors": lambda: figures.plot_errors(runs[1]),
        "states": lambda: figures.plot_states(runs[1]._replace(errors=None)),
        "nees": lambda: figures.plot_nees(runs),
        "nis": lambda: diagnostics.plot_nis(*of_sensor),
        "histogram": lambda: diagnostics.plot_nis_histogram(*of_sensor),
        "whiteness": lambda: diagnostics.plot_whiteness(*of_sensor),
        "verdicts": lambda: diagnostics.plot_verdicts(*of_sensor[:3]),
    }[name]()
    return list(np.ravel(found))


NAMES = "map maps distance errors states nees nis histogram whiteness verdicts".split()


@pytest.mark.parametrize("name", NAMES)
def test_every_figure_has_labels_with_units_and_a_legend(name, problem):
    axes = draw(name, problem)
    figure = axes[0].figure

    assert axes[0].get_legend() or figure.legends
    assert axes[-1].get_xlabel()
    for ax in axes:
        labelled = ax.get_ylabel() or name == "maps"  # only the left one of a row
        assert labelled
    text = axes[-1].get_xlabel() + axes[0].get_ylabel()
    assert "(" in text
    assert figure._supxlabel is None


@pytest.mark.parametrize("name", ["map", "maps"])
def test_maps_have_equal_aspect_and_show_the_arena(name, problem):
    _, _, truth, _ = problem
    for ax in draw(name, problem):
        assert ax.get_aspect() == 1
        (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
        places = np.concatenate([truth.fields["position"], TARGETS["camera"][1]])
        assert np.all((places > [[left, bottom]]) & (places < [[right, top]]))


def test_map_cuts_off_what_strays(problem):
    _, _, truth, (drift, good) = problem
    far = drift.track.mean._replace(position=drift.track.mean.position + 1e4)
    drift = drift._replace(track=drift.track._replace(mean=far))

    ax = maps.plot_map([drift, good], truth, {})

    assert maps.leaves(drift, ax)
    assert not maps.leaves(good, ax)


def test_given_axes_are_used_and_global_settings_left_alone(problem):
    import matplotlib

    rig, recording, truth, runs = problem
    before = dict(matplotlib.rcParams)
    ax = style.subplots(1, 2)[0, 1]

    assert maps.plot_map(runs, truth, {}, ax) is ax
    assert diagnostics.plot_nis(runs[1], recording, rig, "camera", ax) is ax
    assert dict(matplotlib.rcParams) == before


def test_envelope_keeps_extremes_and_order():
    rng = np.random.default_rng(0)
    time, values = np.arange(10_000.0), rng.normal(size=10_000)
    values[4321], values[7000:7100] = 50.0, np.nan

    when, kept = envelope(time, values, 300)

    assert len(kept) <= 600
    assert np.all(np.diff(when) >= 0)
    assert np.nanmax(kept) == 50.0
    assert np.nanmin(kept) == np.nanmin(values)
    assert np.isnan(kept[(when > 7010) & (when < 7060)]).all()
    assert np.array_equal(values[when.astype(int)], kept, equal_nan=True)


def test_envelope_leaves_short_series_alone():
    time = np.arange(5.0)
    assert envelope(time, time)[1] is time


def test_thinning_keeps_what_comes_first():
    chosen, first = np.arange(1000) % 2 == 0, np.arange(1000) % 100 == 0

    kept = thinned(chosen, first, 50)

    assert len(kept) == 50
    assert np.all(chosen[kept])
    assert set(np.flatnonzero(first)) <= set(kept)


def test_ellipses_hold_the_share_they_claim(problem):
    # The outline is where (x - m)' P^-1 (x - m) is the 95 % quantile of chi-square with two.
    run = problem[3][1]
    outlines = ellipses(run, 5)
    chosen = np.unique(np.linspace(0, len(run.track.time) - 1, 5).astype(int))
    for outline, index in zip(outlines, chosen, strict=True):
        away = outline - run.track.mean.position[index][None]
        squared = np.einsum(
            "ai,ij,aj->a", away, np.linalg.inv(run.track.cov[index, :2, :2]), away
        )
        np.testing.assert_allclose(squared, -2 * np.log(0.05), rtol=1e-6)


@pytest.mark.parametrize(("factor", "filled"), [(1.0, True), (1e6, False)])
def test_an_ellipse_that_is_larger_than_the_view_does_not_fill_it(problem, factor, filled):
    _, _, truth, (_, run, *_) = problem
    track = run.track._replace(cov=factor * run.track.cov)
    ax = maps.plot_map([run._replace(track=track)], truth, {})
    assert {patch.get_facecolor()[3] > 0 for patch in ax.patches} == {filled}


def test_a_filter_keeps_its_colour_whatever_runs_beside_it():
    alone = style.looks(["extended"])["extended"]
    names = ["dead-reckoning", "unscented", "extended", "extended+smooth"]
    together = style.looks(names)

    assert together["extended"] == alone
    assert len({look.role for look in together.values()}) == 4
    assert together["dead-reckoning"].role == "dead-reckoning"
    assert together["extended+smooth"].role == "smoother"


def test_looks_of_many_runs_differ():
    names = [f"particle:count={n}" for n in range(12)]
    assert len({str(look) for look in style.looks(names).values()}) == 12


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (0.2134, (0.19, 0.235), ("0.21", "0.19 to 0.23")),
        (4.71, (3.0, 6.6), ("4.7", "3.0 to 6.6")),
        (76.9, (0.0, 135.0), ("77", "0 to 135")),
        (1234.0, (1000.0, 1500.0), ("1200", "1000 to 1500")),
        (0.2134, (), ("0.213", "")),
        (float("nan"), (0.1, 0.2), ("–", "")),
        (0.2, (float("nan"), 0.2), ("0.200", "")),
    ],
)
def test_numbers_are_printed_as_far_as_they_are_known(value, interval, text):
    assert style.measured(value, interval) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0999, "0.10"),
        (-3.14159, "−3.1"),
        (0, "0"),
        (1500.0, "1500"),
        (2.4e-7, "2.4·10⁻⁷"),
        (None, "–"),
        (float("inf"), "–"),
    ],
)
def test_numbers_to_two_digits(value, text):
    assert style.number(value, 2) == text


def test_shares_are_finer_near_none_and_all():
    shares = (0.0, 0.0002, 0.014, 0.5, 0.997, 1.0)
    texts = ["0 %", "0.02 %", "1.4 %", "50 %", "99.7 %", "100 %"]
    assert [style.percent(x).replace("\u00a0", " ") for x in shares] == texts
