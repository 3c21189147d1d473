"""A state that is kept and taken up again: the same answers, and nothing else is taken."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import DataError
from kedge.core.registry import filters
from kedge.estimation import saved
from kedge.estimation.answer import Event
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Rig
from kedge.sensors.gnss import Measurement
from kedge.vehicles.unicycle import Control

START = 1_700_000_000 * 10**9


def story(begin, end):
    """Events as they arrive, some late and one twice, at a clock of an epoch."""
    rng = np.random.default_rng(begin)
    for tick in range(begin, end):
        time = START + 20_000_000 * tick
        yield Event(time, control=Control(1.0, 0.01 * tick) if tick % 3 else None)
        if tick % 5 == 0:
            place = Measurement(np.array([0.02 * tick, 0.0]) + rng.normal(size=2))
            late = Event(time - 130_000_000 * (tick % 10 == 0), "gnss", place)
            yield from [late] * (1 + (tick % 20 == 0))


def made(rig, key, name="extended"):
    return Estimator(filters.make(name), rig, key, start=START, lag=0.5, clock="ns")


def bits(estimator, events):
    rows = estimator.push_many(events)
    return {name: rows[name].tobytes() for name in rows.dtype.names}


@pytest.fixture
def halfway(rig, key):
    estimator = made(rig, key)
    estimator.push_many(story(1, 60))
    return estimator


@pytest.mark.parametrize("name", ["extended", pytest.param("ensemble", marks=pytest.mark.slow)])
def test_later_answers_are_equal_to_the_bit(name, rig, key):
    estimator = made(rig, key, name)
    estimator.push_many(story(1, 30))
    estimator.reset({"heading": 0.2})
    estimator.push_many(story(30, 60))
    state = estimator.state()
    again = Estimator.from_state(state, filters.make(name), rig, key)
    assert again.state() == state
    assert again.time == estimator.time
    for mine, theirs in zip(
        jax.tree.leaves(again.belief), jax.tree.leaves(estimator.belief), strict=True
    ):
        np.testing.assert_array_equal(mine, theirs)
    late = Event(START + 900_000_000, "gnss", Measurement(np.array([0.9, 0.1])))
    later = [late, *story(60, 120), *story(100, 110)]
    assert bits(again, later) == bits(estimator, later)
    third = Estimator.from_state(again.state(), filters.make(name), rig, key)
    assert third.resets == 1
    assert third.reset({"heading": 0.1}).delta.tobytes() == (
        estimator.reset({"heading": 0.1}).delta.tobytes()
    )
    assert bits(third, story(120, 130)) == bits(estimator, story(120, 130))


@pytest.mark.slow
def test_after_a_swap_it_is_the_state_of_the_new_filter(halfway, rig, key):
    halfway.swap(filters.make("unscented"))
    state = halfway.state()
    with pytest.raises(DataError, match="it is of another filter"):
        Estimator.from_state(state, filters.make("extended"), rig, key)
    again = Estimator.from_state(state, filters.make("unscented"), rig, key)
    assert bits(again, story(60, 120)) == bits(halfway, story(60, 120))


def test_what_has_changed_is_refused(halfway, rig, key):
    state = halfway.state()
    again = lambda data: Estimator.from_state(data, filters.make("extended"), rig, key)  # noqa: E731
    damaged = bytearray(state)
    for place in (len(saved.MARK), len(state) // 2, len(state) - 1):
        damaged[place] ^= 1
        with pytest.raises(DataError, match="its checksum is wrong"):
            again(bytes(damaged))
        damaged[place] ^= 1
    for data in (state[:-1], state[: len(saved.MARK)]):
        with pytest.raises(DataError, match="its checksum is wrong"):
            again(data)
    for data in (b"", b"PK\x03\x04", state.replace(b"state 1", b"state 2", 1)):
        with pytest.raises(DataError, match="it begins with"):
            again(data)


def test_something_else_is_refused_by_name(halfway, rig, key, monkeypatch):
    state = halfway.state()
    wider = Rig(rig.vehicle, rig.sensors, Gaussian(rig.prior.mean, 2 * jnp.eye(3)))
    extended = filters.make("extended")
    other = "native" if os.environ.get("KEDGE_ENGINE") == "xla" else "xla"
    for name, given in {
        "rig": (extended, wider, key),
        "filter": (filters.make("unscented"), rig, key),
        "key": (extended, rig, jax.random.key(99)),
        "engine": (extended, rig, key, other),
    }.items():
        with pytest.raises(DataError, match=f"it is of another {name}: found"):
            Estimator.from_state(state, *given)
    monkeypatch.setattr(saved, "key_of", lambda text: "another processor")
    monkeypatch.setattr(saved.platform, "processor", lambda: "another processor")
    with pytest.raises(DataError, match="it is of another machine"):
        Estimator.from_state(state, extended, rig, key)


PRINT = """
import kedge, jax.numpy as jnp
from kedge.estimation.saved import digest
vehicle = kedge.make_vehicle("unicycle")
gnss = kedge.Installation("gnss", kedge.make_sensor("gnss", std=0.5), gate=0.01)
rig = kedge.Rig(vehicle, (gnss,), kedge.Gaussian(vehicle.start(), jnp.eye(3)))
print(digest((rig, kedge.make_filter("ensemble"))))
"""


@pytest.mark.slow
def test_another_process_knows_the_rig_again():
    digests = {
        subprocess.run(
            [sys.executable, "-c", PRINT],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(digests) == 1
