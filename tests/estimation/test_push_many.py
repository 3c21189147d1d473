"""Waiting events in one call: the answers of as many calls, to the bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError, DataError
from kedge.core.registry import filters
from kedge.core.verdicts import Verdict
from kedge.estimation import native
from kedge.estimation.answer import Event
from kedge.estimation.online import Estimator
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Measurement
from kedge.sensors.landmarks import Measurement as Sight
from kedge.vehicles.unicycle import Control

EAST = Measurement(np.array([1.0, 0.0]))


def bits(rows):
    """What stands in each field; between them lies what was there before."""
    return {name: rows[name].tobytes() for name in rows.dtype.names}


def story(rng):
    """Two seconds as they arrive: late and doubled fixes, covariances, NaN, outliers."""
    events = []
    for tick in range(1, 101):
        time = 0.02 * tick
        control = Control(np.nan if tick == 40 else 1.0, 0.01 * tick)
        events.append((time, Event(time, control=control if tick % 3 else None)))
        if tick % 5 == 0:
            place = np.array([time, 0.0]) + rng.normal(size=2) + 100 * (tick == 50)
            place = np.full(2, np.nan) if tick == 15 else place
            fix = Event(
                time,
                "gnss",
                Measurement(place),
                cov=0.3 * np.eye(2) if tick % 2 else None,
                control=Control(1.1, 0.0) if tick == 60 else None,
            )
            events += [(time + 0.3 * rng.random(), fix)] * (2 if tick % 20 == 0 else 1)
        if tick % 7 == 0:
            events += [
                (time, Event(time, "camera", Sight(20.0, 0.8), target=i)) for i in (0, 1, 99)
            ]
    events.append((0.9, Event(0.1, "gnss", EAST)))
    return [event for _, event in sorted(events, key=lambda pair: pair[0])]


@pytest.mark.parametrize("name", ["extended", "ensemble"])
@pytest.mark.parametrize("lag", [0.0, 0.5])
def test_many_are_each_in_turn_to_the_bit(name, lag, rig, key):
    events = story(np.random.default_rng(0))[: None if name == "extended" else 85]
    singly = Estimator(filters.make(name), rig, key, lag=lag, horizon=10.0)
    answers = [singly.push(**event._asdict()) for event in events]
    one = np.concatenate([answer.row for answer in answers])
    verdicts = {Verdict(v) for v in one["verdict"].tolist()}
    assert (one["replayed"] > 0).any() == (lag > 0)
    # Without a lag the fix that is not finite is late as well.
    usual = {Verdict.FUSED, Verdict.LATE} | ({Verdict.NOT_FINITE} if lag else set())
    assert usual <= verdicts
    for parts in ([len(events)], [1, 2, 3, 5, 20, len(events)]):
        many, rows, begin = (
            Estimator(filters.make(name), rig, key, lag=lag, horizon=10.0),
            [],
            0,
        )
        for size in parts:
            rows.append(many.push_many(events[begin : begin + size]))
            begin += size
        assert bits(np.concatenate(rows)) == bits(one)
        assert many.time == singly.time
        for mine, theirs in zip(
            jax.tree.leaves(many.belief), jax.tree.leaves(singly.belief), strict=True
        ):
            np.testing.assert_array_equal(mine, theirs)


def test_answers_as_objects(rig, key):
    estimator = Estimator(ExtendedKalman(), rig, key)
    rows = estimator.push_many([Event(0.5, "gnss", EAST), Event(1.0)])
    fused, silent = estimator.answers(rows)
    assert (fused.verdict, silent.verdict) == (Verdict.FUSED, Verdict.NONE)
    np.testing.assert_array_equal(silent.moments.cov, estimator.belief.cov)
    assert rows["nis"][0] == fused.outcome.nis
    assert len(estimator.push_many([])) == 0


def test_nothing_is_done_if_one_of_them_has_another_form(rig, key):
    estimator = Estimator(ExtendedKalman(), rig, key)
    with pytest.raises(ContractError, match="found Measurement, expected landmarks"):
        estimator.push_many([Event(0.5, "gnss", EAST), Event(1.0, "camera", EAST)])
    assert estimator.time == 0
    rows = estimator.rows([Event(0.5, "gnss", EAST)])
    rows["sensor"] = 7
    with pytest.raises(DataError, match="push_many: sensor: found 7, expected -1 to 1"):
        estimator.push_many(rows)
    with pytest.raises(DataError, match="push_many: found an array of float64 numbers"):
        estimator.push_many(np.zeros(3))
    assert estimator.time == 0


def test_rows_may_be_used_again(rig, key):
    """Nothing is written into what a caller gave."""
    one = Estimator(ExtendedKalman(), rig, key)
    rows = one.rows([Event(0.5, control=Control(np.nan, 0.0)), Event(1.0, "gnss", EAST)])
    before = rows.tobytes()
    first = one.push_many(rows)
    assert rows.tobytes() == before
    assert first["control"].tolist() == [Verdict.NOT_FINITE, Verdict.NONE]
    other = Estimator(ExtendedKalman(), rig, key)
    assert bits(other.push_many(rows)) == bits(first)


EPOCH = 1_700_000_000 * 10**9


def test_nanoseconds_at_the_epoch_are_told_apart(rig, key):
    """Floats of seconds are 238 ns apart there."""
    estimator = Estimator(ExtendedKalman(), rig, key, start=EPOCH, clock="ns", lag=1.0)
    first = estimator.push(EPOCH + 10**8, "gnss", EAST)
    again = estimator.push(EPOCH + 10**8, "gnss", EAST)
    later = estimator.push(EPOCH + 10**8 + 100, "gnss", EAST)
    verdicts = [answer.verdict for answer in (first, again, later)]
    assert verdicts == [Verdict.FUSED, Verdict.DUPLICATE, Verdict.FUSED]
    assert estimator.time == EPOCH + 10**8 + 100
    assert [time for time, _ in estimator.smoothed()] == [EPOCH + 10**8, EPOCH + 10**8 + 100]


def test_an_epoch_costs_no_digit(rig, key):
    """Times are counted from the start, so the estimate is that of a clock from 0."""
    epoch = Estimator(ExtendedKalman(), rig, key, start=EPOCH, clock="ns")
    zero = Estimator(ExtendedKalman(), rig, key)
    for tick in range(1, 9):
        one = epoch.push(EPOCH + tick * 10**8, "gnss", EAST).moments
        other = zero.push(tick / 10, "gnss", EAST).moments
    np.testing.assert_array_equal(one.cov, other.cov)


@pytest.mark.parametrize("time", [1.5, "1", None, 2**80])
def test_nanoseconds_are_whole(rig, time):
    estimator = Estimator(ExtendedKalman(), rig, clock="ns")
    with pytest.raises(DataError, match="expected whole nanoseconds"):
        estimator.push(time)


def test_an_answer_that_is_written_into_spoils_nothing(rig, key):
    estimator = Estimator(ExtendedKalman(), rig, key)
    answer = estimator.push(1.0, "gnss", EAST)
    answer.moments.cov[:] = np.nan
    assert np.isfinite(estimator.push(0.5, "gnss", EAST).moments.cov).all()
    assert np.isfinite(jnp.asarray(estimator.belief.cov)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["extended", "ensemble"])
@pytest.mark.parametrize("engine", ["native", "xla"])
def test_after_ready_nothing_compiles(name, engine, rig, key, monkeypatch):
    """Neither a first covariance, refusal or look ahead nor the smoother of the window."""
    if name == "ensemble" and engine == "native":
        pytest.skip("it draws random numbers")
    estimator = Estimator(filters.make(name), rig, key, lag=0.5, horizon=10.0, engine=engine)
    before = estimator.push(0.01).row
    estimator.ready()
    compiled = []
    heard = jax.monitoring.register_event_duration_secs_listener
    heard(lambda event, *_, **__: compiled.append(event) if "compile" in event else None)
    monkeypatch.setattr(native, "_compiled", lambda *_: compiled.append("machine code"))
    try:
        for event in story(np.random.default_rng(0))[:60]:
            estimator.push(**event._asdict())
            estimator.push(event.time, "camera", Sight(20.0, 0.8), cov=np.eye(2) * 0.1)
        estimator.push(99.0, "gnss", EAST)
        estimator.peek(estimator.time + 0.1)
        estimator.smoothed()
    finally:
        jax.monitoring.clear_event_listeners()
    assert compiled == []
    assert before["verdict"] == Verdict.NONE


def test_to_be_ready_changes_nothing(rig, key):
    one, other = (Estimator(ExtendedKalman(), rig, key, lag=0.5) for _ in range(2))
    for estimator in (one, other):
        estimator.push(0.5, "gnss", EAST, control=Control(1.0, 0.1))
    one.ready()
    answers = [estimator.push(0.4, "gnss", EAST).row for estimator in (one, other)]
    assert bits(answers[0]) == bits(answers[1])
    assert one.time == other.time == 0.5
