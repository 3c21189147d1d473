"""Particle filters beside `particles` (Chopin), and resampling beside FilterPy.

`particles` 0.4 wants NumPy below 2, so it runs as a program in an environment of its own:
``build/particles``, made here if the network allows, or the interpreter named by
``KEDGE_PARTICLES``. Both filter the same readings with the same model, number, resampling and
threshold, and both report the mean and the variance after every reading; that they are equally
good is checked against the Kalman filter.
"""

import json
import subprocess
from pathlib import Path
from typing import NamedTuple

import filterpy.monte_carlo
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.conftest import interpreter

import kedge
from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Range
from kedge.estimation.batch import compile_estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.numerics.resampling import SCHEMES

RIVAL = "particles==0.4"
SCRIPT = Path(__file__).with_name("particles_cycles.py")
A, Q, R, START = 0.9, 0.7, 0.3, 1.0
ROUNDS = 10_000
"""Particles that are resampled one after the other for one figure."""
CYCLES = {100: 500, 1000: 500, 10_000: 200, 100_000: 50}


class Place(NamedTuple):
    place: Range


class Linear(kedge.AbstractVehicle[Place, tuple, Place]):
    """x' = a x + w, one step a second."""

    def step(self, state, control, noise, dt):
        return Place(A * state.place + noise.place * dt)

    def noise_density(self):
        return Place(Q)

    def start(self):
        return Place(jnp.array(0.0))

    def nominal_control(self, time):
        return ()


class Direct(AbstractSensor[Place]):
    """z = x + v."""

    reads = Place
    measures = Place

    def observe(self, state):
        return Place(state.place)

    def noise_std(self, state):
        return Place(R)


@pytest.fixture(scope="module")
def rival():
    """The interpreter of an environment with the package."""
    return interpreter(RIVAL)


def readings(cycles):
    rng = np.random.default_rng(1)
    place, seen = START * rng.normal(), []
    for _ in range(cycles):
        place = A * place + Q * rng.normal()
        seen.append(place + R * rng.normal())
    return np.array(seen)


def compiled(name, seen, **parameters):
    cycles = len(seen)
    prior = kedge.Gaussian(Linear().start(), START**2 * jnp.eye(1))
    rig = kedge.Rig(Linear(), (kedge.Installation("direct", Direct()),), prior)
    schedule = Schedule(np.arange(1.0, cycles + 1), np.zeros(cycles, int), np.arange(cycles))
    log = Log(schedule, (), (Readings(Place(seen), np.zeros(cycles, int)),))
    call = compile_estimate(kedge.make_filter(name, **parameters), rig, log, keep=False)
    return lambda: jax.block_until_ready(call()[0].moments)


@pytest.mark.parametrize("count", CYCLES)
@pytest.mark.parametrize("name", ["particle", "guided"])
def test_step(name, count, rival, times):
    cycles = CYCLES[count]
    seen = readings(cycles)
    found, seconds = times.best(compiled(name, seen, count=count), 5)
    case = {"filter": name, "count": count, "readings": seen.tolist(), "repeats": 3}
    case |= {"a": A, "q": Q, "r": R, "start": START}
    answer = subprocess.run(
        [rival, SCRIPT], input=json.dumps([case]), capture_output=True, text=True, check=True
    )
    (theirs,) = json.loads(answer.stdout)
    exact = np.asarray(compiled("kalman", seen)().mean.place)
    # The median: one improbable reading, after which few particles count, rules a mean square.
    ours = np.median(np.abs(np.asarray(found.mean.place) - exact))
    other = np.median(np.abs(np.array(theirs["means"]) - exact))
    assert ours < 1.5 * other
    what = f"{name}, N {count}"
    times.row(what, "particles", theirs["seconds"], seconds / cycles, at_least=1)
    times.note(f"{what}: median distance from the exact mean {ours:.2g}, particles {other:.2g}")


@pytest.mark.parametrize("count", CYCLES)
@pytest.mark.parametrize("name", SCHEMES)
def test_resampling(name, count, times):
    weights = np.random.default_rng(0).dirichlet(np.ones(count))
    rounds = max(1, ROUNDS // count)
    logs, keys = jnp.log(weights), jax.random.split(jax.random.key(0), rounds)

    def each(keys, logs):  # one after the other in a compiled loop, as filters call it
        return jax.lax.map(lambda key: SCHEMES[name](key, logs), keys)

    ours = jax.jit(each).lower(keys, logs).compile()
    chosen, seconds = times.best(lambda: jax.block_until_ready(ours(keys, logs)), 5)
    scheme = getattr(filterpy.monte_carlo, f"{name}_resample")
    other, theirs = times.best(lambda: [scheme(weights) for _ in range(rounds)], 3)
    for indices in (chosen[0], other[0]):
        copies = np.bincount(indices, minlength=count)
        # Of independent draws nearly Poisson; the other schemes come nearer.
        assert np.all(abs(copies - count * weights) < 7 * np.sqrt(count * weights + 1))
    times.row(f"{name}, N {count}", "FilterPy", theirs / rounds, seconds / rounds, 1)
