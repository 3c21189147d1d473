"""Tuning finds what made the log, says how well it knows it, and names what it cannot know."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ConfigError, ContractError, DataError
from kedge.estimation.batch import estimate
from kedge.estimation.log import SECOND, Readings, Stamped, Truth, assemble
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.score import errors_of, track_of
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.tuning.evaluator import Case, Evaluator
from kedge.tuning.log import arranged, timeline
from kedge.tuning.loss import consistent_weight
from kedge.tuning.tunable import choose, placed, tunables
from kedge.tuning.tuning import Search
from kedge.tuning.tuning import tune as tune_cases
from kedge.vehicles.commanded import Commanded
from kedge.vehicles.constant_velocity import ConstantVelocity, DiscreteWhiteAcceleration

NOISE, STD = 0.3, 0.5


def buoy(noise=NOISE, std=STD, **given):
    vehicle = ConstantVelocity(acceleration_noise=noise)
    sensor = Installation("gnss", Gnss(std=std), rate=2.0, **given)
    return Rig(vehicle, (sensor,), Gaussian(vehicle.start(), 0.1 * jnp.eye(4)))


def recorded(seed, duration=100.0):
    scenario = Scenario(buoy(), duration=duration, dt=0.5)
    return record(scenario, jr.key(seed), output_rate=2.0)


def evaluator_of(rig, recording, truth=None, horizons=()):
    chosen = tuple(choose(rig, None))
    cases = [Case(rig, recording, truth)]
    return Evaluator(ExtendedKalman(), cases, chosen, np.full(2, 9.0), horizons)


def tune(filter, rig, recording, chosen, truth=None, until=np.inf, search=None):
    return tune_cases(filter, [Case(rig, recording, truth, until)], chosen, search)


@pytest.fixture(scope="module")
def found():
    recording, truth = recorded(1)
    wrong = buoy(noise=3.0, std=0.05)
    search = Search(starts=2)
    chosen = choose(wrong, None)
    filter = ExtendedKalman()
    return {
        "innovations": tune(filter, wrong, recording, chosen, search=search),
        "truth": tune(filter, wrong, recording, chosen, truth, search=search),
    }


@pytest.mark.parametrize("criterion", ["innovations", "truth"])
def test_it_finds_what_made_the_log(found, criterion):
    tuned = found[criterion]
    assert [t.key for t in tuned.chosen] == [
        "vehicle.parameters.acceleration_noise",
        "sensors.gnss.parameters.std",
    ]
    for value, judgement, true in zip(
        tuned.values, tuned.judgements, (NOISE, STD), strict=True
    ):
        assert judgement.identified
        assert judgement.verdict == "yes"
        assert abs(np.log(value / true)) < 3 * judgement.std_error
        assert judgement.std_error < 0.3
    assert tuned.flat == ()
    assert tuned.agreed == 2
    assert tuned.loss_after < tuned.loss_before
    assert tuned.judged == 200


def test_the_standard_error_is_that_of_counting(found):
    # 200 readings of two components of which R is most of S: about 1/sqrt(2 * 400).
    error = found["innovations"].judgements[1].std_error
    assert 0.8 < error * np.sqrt(2 * 400) < 1.8


def test_the_profile_is_a_parabola_near_its_foot(found):
    for values, rises in found["innovations"].profiles.values():
        assert rises[len(rises) // 2] == 0
        assert (rises > -1e-9).all()
        steps = np.log(values / values[len(values) // 2])
        assert np.corrcoef(steps**2, rises)[0, 1] > 0.99


@pytest.mark.slow
def test_standard_errors_cover():
    scores = []
    for seed in range(24):
        recording, _ = recorded(100 + seed)
        rig = buoy()
        tuned = tune(
            ExtendedKalman(), rig, recording, choose(rig, None), search=Search(starts=1)
        )
        errors = [j.std_error for j in tuned.judgements]
        scores.append(np.log(tuned.values / [NOISE, STD]) / errors)
    scores = np.array(scores)
    assert abs(scores.mean(axis=0) * np.sqrt(24)).max() < 3.5
    # The larger of two estimates of the error is taken, so coverage is rather too high.
    assert (abs(scores) < 1.96).mean() > 0.85


@pytest.mark.parametrize("with_truth", [False, True], ids=["innovations", "truth"])
def test_gradient_is_that_of_finite_differences(with_truth):
    recording, truth = recorded(2, duration=20.0)
    evaluate = evaluator_of(buoy(), recording, truth if with_truth else None)
    point = evaluate.coordinates([0.2, 0.7])
    gradient = evaluate(point).gradient
    for i, step in enumerate(1e-5 * np.eye(2)):
        slope = (evaluate(point + step).total - evaluate(point - step).total) / 2e-5
        assert gradient[i] == pytest.approx(slope, rel=1e-5)
    np.testing.assert_allclose(evaluate(point).blocks.sum(axis=0), gradient, rtol=1e-12)


def test_the_loss_of_innovations_is_the_filters_log_likelihood():
    recording, _ = recorded(2, duration=20.0)
    evaluate = evaluator_of(buoy(), recording)
    outcome = estimate(ExtendedKalman(), buoy(0.2, 0.7), recording.log).outcome
    total = evaluate(evaluate.coordinates([0.2, 0.7])).total
    assert total == pytest.approx(-float(outcome.log_likelihood.sum()), rel=1e-12)


def test_the_loss_of_truth_is_the_density_of_the_error():
    recording, truth = recorded(2, duration=20.0)
    evaluate = evaluator_of(buoy(), recording, truth)
    found = estimate(ExtendedKalman(), buoy(0.2, 0.7), recording.log)
    from scipy.stats import multivariate_normal

    errors = errors_of(track_of(found, recording), truth)
    there = ~np.isnan(errors.error).any(axis=1)
    expected = -sum(
        multivariate_normal(cov=cov).logpdf(error)
        for error, cov in zip(errors.error[there], errors.cov[there], strict=True)
    )
    total = evaluate(evaluate.coordinates([0.2, 0.7])).total
    assert total == pytest.approx(expected, rel=1e-9)


def test_two_noises_of_which_only_the_product_counts_are_not_told_apart():
    vehicle = DiscreteWhiteAcceleration(acceleration_std=0.5, period=0.5)
    rig = Rig(vehicle, buoy().sensors, buoy().prior)
    chosen = choose(rig, ["acceleration_std", "period", "std"])
    tuned = tune(ExtendedKalman(), rig, recorded(1)[0], chosen, search=Search(starts=1))
    first, second, third = tuned.judgements
    assert not first.identified
    assert not second.identified
    assert third.identified
    assert first.verdict == "no: only together with vehicle.parameters.period"
    assert len(tuned.flat) == 1
    assert "acceleration_std" in tuned.flat[0]
    assert "period" in tuned.flat[0]
    assert "gnss" not in tuned.flat[0]
    # The product itself is found all the same.
    assert tuned.values[0] * tuned.values[1] ** 0.5 == pytest.approx(NOISE, rel=0.5)


def test_noise_that_is_not_there_ends_at_its_bound_or_flat():
    still = Rig(ConstantVelocity(0.0), buoy().sensors, buoy().prior)
    recording, _ = record(Scenario(still, duration=100.0, dt=0.5), jr.key(3), 2.0)
    tuned = tune(
        ExtendedKalman(), buoy(), recording, choose(buoy(), None), search=Search(starts=1)
    )
    assert not tuned.judgements[0].identified
    assert tuned.judgements[0].verdict.startswith("no")
    assert tuned.values[0] < 0.03
    assert tuned.judgements[1].identified


def expected_pull(dof, scale=1.0):
    """Mean over normal noise of a Student-t's pull on a scale, for 4 degrees of freedom."""
    from scipy.stats import chi2

    def pull(q):
        return (4 + dof) * q / (4 * scale**2 + q) * chi2(dof).pdf(q)

    return quad(pull, 0, 100, limit=200)[0]


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_the_weight_makes_normal_noise_come_out_at_its_own_scale(dof):
    assert consistent_weight(4.0, dof) * expected_pull(dof) == pytest.approx(dof, rel=1e-6)
    assert consistent_weight(1e9, dof) == pytest.approx(1, rel=1e-6)


def test_outliers_behind_a_gate_do_not_widen_the_noise():
    recording, _ = recorded(1)
    (readings,) = recording.log.readings
    wild = np.array(readings.measurement.position)
    wild[::10] += 30.0
    log = recording.log._replace(
        readings=(readings._replace(measurement=type(readings.measurement)(wild)),)
    )
    found = {}
    for gate in (None, 1e-4):
        rig = buoy(gate=gate)
        tuned = tune(
            ExtendedKalman(),
            rig,
            recording._replace(log=log),
            choose(rig, None),
            search=Search(starts=1),
        )
        found[gate] = tuned.values[1]
    assert "without a gate" in tuned.notes[0]
    assert found[None] > 5
    # Where one reading in ten is gross, every one of them pulls with all its weight.
    weight = consistent_weight(4.0, 2)
    widened = brentq(
        lambda scale: 0.9 * weight * expected_pull(2, scale) + 0.1 * weight * 6 - 2, 0.5, 5
    )
    assert 1.2 < widened < 1.4
    assert found[1e-4] == pytest.approx(STD * widened, rel=0.1)


def moving(latency, seed=4):
    """A buoy adrift, seen twice a second, each fix stamped ``latency`` seconds late."""
    recording, truth = recorded(seed)
    (readings,) = recording.log.readings
    stamps = recording.stamps[np.asarray(recording.log.schedule.sensor) == 0]
    late = Stamped(stamps + round(latency * SECOND), readings)
    end = int(recording.stamps[-1])
    empty = type(recording.log.controls)()
    return assemble(0, end + SECOND, np.zeros(0, int), empty, [late], 2.0), truth


def test_a_latency_is_found():
    rig = buoy(noise=NOISE, std=0.5)
    recording, truth = moving(0.13)
    (latency,) = choose(rig, ["latency"])
    tuned = tune(ExtendedKalman(), rig, recording, [latency], truth, search=Search(starts=1))
    (judgement,) = tuned.judgements
    assert judgement.identified
    assert abs(tuned.values[0] - 0.13) < 3 * judgement.std_error
    assert judgement.std_error < 0.05


def test_a_log_rearranged_is_the_log_assembled_with_that_latency():
    vehicle = Commanded()
    random = np.random.default_rng(0)
    told = np.sort(random.integers(1, 10 * SECOND, 40))
    told[0] = 0
    controls = type(vehicle.nominal_control(0.0))(
        random.normal(size=40), random.normal(size=40)
    )
    sensor = Gnss()
    stamps = np.sort(random.integers(1 * SECOND, 9 * SECOND, 30))
    place = sensor.measures(random.normal(size=(30, 2)))
    readings = Readings(place, np.zeros(30, int))

    def log(latency):
        moved = Stamped(stamps - round(latency * SECOND), readings)
        return assemble(0, 10 * SECOND, told, controls, [moved], 3.0)

    base = log(0.0)
    line = timeline(base, 8.0, np.array([0.5]))
    for latency in (0.0, 0.3, -0.4):
        shift = np.array([latency])
        other, own = log(latency), arranged(line, shift)
        time = own.log.schedule.time - np.where(own.log.schedule.sensor == 0, latency, 0.0)
        count = int(np.searchsorted(np.asarray(other.log.schedule.time), 7.0))
        for ours, theirs in (
            (time, other.log.schedule.time),
            (own.log.schedule.sensor, other.log.schedule.sensor),
            (own.log.schedule.row, other.log.schedule.row),
            (own.log.controls.speed, other.log.controls.speed),
        ):
            np.testing.assert_allclose(ours[:count], theirs[:count], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(own.outputs[:10], other.outputs[:10])


def test_only_the_first_part_is_judged():
    recording, _ = recorded(1)
    rig = buoy()
    tuned = tune(
        ExtendedKalman(), rig, recording, choose(rig, None), until=50.0,
        search=Search(starts=1),
    )  # fmt: skip
    assert tuned.judged == 100


def test_what_is_noise_is_asked_of_the_models():
    vehicle = Commanded()
    rig = Rig(vehicle, buoy().sensors, Gaussian(vehicle.start(), jnp.eye(4)))
    noise = {t.key.split(".")[-1] for t in tunables(rig) if t.is_noise}
    assert noise == {
        "slip", "turning_slip", "yaw_slip", "rolling_yaw_slip", "motor_noise", "std",
    }  # fmt: skip
    others = {t.key.split(".")[-1] for t in tunables(rig)} - noise
    assert others == {
        "speed_scale", "turn_slowdown", "yaw_rate_scale", "yaw_rate_bias", "yaw_per_metre",
        "lag", "latency",
    }  # fmt: skip


def test_values_stand_where_they_were_put():
    rig = buoy()
    chosen = choose(rig, ["std", "acceleration_noise"])
    other = placed(rig, chosen, jnp.array([7.0, 8.0]))
    assert float(other.sensors[0].sensor.std) == 7.0
    assert float(other.vehicle.acceleration_noise) == 8.0
    assert jax.tree.structure(other) == jax.tree.structure(rig)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["stdd"], "no parameter called 'stdd'"),
        (["std", "gnss.parameters.std"], "sensors.gnss.parameters.std twice"),
        ([], "found none"),
    ],
)
def test_names_that_cannot_be_meant(names, said):
    with pytest.raises(ConfigError, match=said):
        choose(buoy(), names)


@pytest.mark.parametrize(
    ("search", "said"),
    [
        (Search(starts=0), "starts: found 0"),
        (Search(span=1.0), "span: found 1"),
        (Search(bounds={"x": (0.0, 1.0)}), "x is not tuned"),
        (Search(bounds={"sensors.gnss.parameters.std": (0.0, 1.0)}), "one above 0"),
        (Search(bounds={"sensors.gnss.parameters.std": (1.0, 2.0)}), "the start 0.5"),
    ],
)
def test_searches_that_cannot_be_made(search, said):
    recording, _ = recorded(1)
    with pytest.raises(ConfigError, match=said):
        tune(ExtendedKalman(), buoy(), recording, choose(buoy(), None), search=search)


def test_rigs_and_filters_that_cannot_be_tuned():
    recording, truth = recorded(1)
    rig = buoy()
    chosen = choose(rig, None)
    with pytest.raises(ContractError, match="carries no Gaussian"):
        tune(BootstrapParticle(), rig, recording, chosen)
    still = buoy(noise=0.0)
    with pytest.raises(ConfigError, match=r"found 0, expected a start above 0"):
        tune(ExtendedKalman(), still, recording, choose(still, ["acceleration_noise"]))
    elsewhere = Truth(truth.time + 1e4, truth.fields)
    with pytest.raises(DataError, match="covers none"):
        tune(ExtendedKalman(), rig, recording, chosen, elsewhere)
    blind = recording._replace(
        log=jax.tree.map(np.asarray, recording.log)._replace(
            readings=(Readings(Gnss().measures(np.full((200, 2), np.nan)), np.zeros(200, int)),)
        )
    )
    with pytest.raises(ContractError, match="fused no reading"):
        tune(ExtendedKalman(), rig, blind, chosen)
