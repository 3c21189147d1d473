"""The estimator: the batch, one event at a time."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError, DataError
from kedge.core.registry import filters
from kedge.core.verdicts import Verdict
from kedge.estimation import traced_step
from kedge.estimation.batch import estimate
from kedge.estimation.online import Estimator
from kedge.estimation.replay import replay
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Measurement
from kedge.sensors.landmarks import Measurement as Sight
from kedge.vehicles.unicycle import Control

EAST = Measurement(np.array([1.0, 0.0]))
CONTROL = Control(1.0, 0.2)


def row(tree, index):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def leaves(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(leaves(one), leaves(other), strict=True))


def spoilt(log):
    """Components missing, a whole row missing, an infinity, a stranger, an outlier."""
    fixes, sights = log.readings
    place = fixes.measurement.position.copy()
    place[1, 0], place[2], place[3, 1] = np.nan, np.nan, np.inf
    distance, bearing, target = (x.copy() for x in (*sights.measurement, sights.target))
    distance[1], bearing[2], target[3], bearing[4] = np.nan, np.nan, -1, bearing[4] + 1
    target[5] = 99
    return log._replace(
        readings=(
            fixes._replace(measurement=Measurement(place)),
            sights._replace(measurement=Sight(distance, bearing), target=target),
        )
    )


# Every other filter has to be so by its contract.
@pytest.mark.parametrize("name", ["extended", "dead-reckoning"])
def test_online_is_the_batch_with_all_kinds_of_readings(name, rig, log, extended, key):
    filter, log = filters.make(name), spoilt(log)
    if name == "extended":
        batch = extended(readings=log.readings)
    else:
        batch = estimate(filter, rig, log, key)
    estimator = Estimator(filter, rig, key, control=row(log.controls, 0))
    for i, answer in enumerate(replay(estimator, log)):
        assert int(answer.verdict) == int(batch.outcome.verdict[i])
        for a, b in zip(leaves(answer.moments), leaves(row(batch.moments, i)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
        for a, b in zip(leaves(answer.outcome), leaves(row(batch.outcome, i)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)
    seen = {Verdict(int(v)) for v in batch.outcome.verdict}
    usual = {Verdict.NONE, Verdict.FUSED, Verdict.GATED}
    if name == "dead-reckoning":
        usual = {Verdict.NONE, Verdict.DROPPED}
    assert seen == usual | {Verdict.NOT_FINITE, Verdict.UNKNOWN_TARGET}


@pytest.fixture(
    params=[ExtendedKalman(), EnsembleKalman(count=7)], ids=["extended", "ensemble"]
)
def make(request, rig, key):
    return lambda **given: Estimator(request.param, rig, key, **given)


def test_what_is_older_than_the_belief_changes_nothing(make):
    """Law 5, and nothing later is changed either: not even the draws of an ensemble."""
    one, other = make(), make()
    for estimator in (one, other):
        estimator.push(1.0, "gnss", EAST, control=CONTROL)
    before, late = one.belief, one.push(0.5, "gnss", EAST, control=Control(9.0, 9.0))
    assert late.verdict == Verdict.LATE
    assert one.belief is before
    assert same(late.moments, one.belief.moments())
    assert one.time == 1.0
    assert np.isnan(late.outcome.nis)
    assert same(*(e.push(2.0, "gnss", EAST).moments for e in (one, other)))


def test_an_ensemble_reports_the_covariance_of_its_members(rig, key):
    """Law 3; FilterPy reports another one."""
    estimator = Estimator(EnsembleKalman(count=7), rig, key)
    answer = estimator.push(1.0, "gnss", EAST)
    members = estimator.belief.members
    sample = np.cov(np.column_stack([members.position, members.heading]).T)
    np.testing.assert_allclose(answer.moments.cov, sample, rtol=1e-9)


def test_readings_at_one_time_are_all_in_time(make):
    estimator = make()
    assert estimator.push(1.0, "gnss", EAST).verdict == Verdict.FUSED
    again = Measurement(np.array([1.0, 0.1]))
    assert estimator.push(1.0, "gnss", again).verdict == Verdict.FUSED


@pytest.mark.parametrize("time", [float("nan"), float("inf")])
def test_a_time_that_is_none_is_refused(make, time):
    with pytest.raises(DataError, match=f"event time is {time}; expected seconds"):
        make().push(time)


def test_a_push_that_raises_changes_nothing(make):
    one, other = make(), make()
    with pytest.raises(ContractError, match=r"no sensor 'sonar' on this rig.*'gnss', 'camera'"):
        one.push(1.0, "sonar", EAST, control=CONTROL)
    assert one.time == 0
    assert same(*(e.push(1.0, "gnss", EAST).moments for e in (one, other)))


def test_a_control_holds_until_the_next(make):
    """From rest, one control from the start, and one that comes later: the same draws."""
    rest, driven, told = make(), make(control=CONTROL), make()
    rest.push(0.5)
    driven.push(0.5)
    told.push(0.5, control=CONTROL)
    for estimator in (rest, driven, told):
        estimator.push(1.0)
    first = [float(e.belief.moments().mean.position[0]) for e in (rest, driven, told)]
    np.testing.assert_allclose(np.subtract(first, first[0]), [0, 1, 0.5], atol=0.1)


def test_whole_numbers_are_numbers(make):
    one, other = make(), make()
    one.push(1.0, "camera", Sight(22, 1), target=0, control=Control(1, 0))
    other.push(
        1.0,
        "camera",
        Sight(22.0, jnp.array(1.0)),
        target=jnp.asarray(0),
        control=Control(1.0, np.float32(0)),
    )
    assert same(one.push(2.0).moments, other.push(2.0).moments)


def test_a_start_that_is_not_zero(make):
    one, other = make(), make(start=100.0)
    for a, b in zip(
        leaves(one.push(1.0).moments), leaves(other.push(101.0).moments), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_every_program_is_compiled_once(rig, key, monkeypatch):
    """Weakly typed numbers, fresh covariances and new parameters are no new types."""
    monkeypatch.setenv("KEDGE_ENGINE", "xla")
    traced = []
    for name in ("predict_to", "process_measurement"):
        inner = getattr(traced_step, name)

        def counted(*arguments, inner=inner, name=name):
            traced.append(name)
            return inner(*arguments)

        monkeypatch.setattr(traced_step, f"_{name}", eqx.filter_jit(counted))
    for std in (0.1, 0.2):
        prior = rig.prior._replace(cov=std * jnp.eye(3))
        estimator = Estimator(ExtendedKalman(), type(rig)(rig.vehicle, rig.sensors, prior), key)
        for time in range(1, 5):
            estimator.push(time / 2, "gnss", EAST, control=Control(time, jnp.array(0.1)))
    assert sorted(traced) == ["predict_to", "process_measurement"]
