"""Gaussian filters beside dynamax and cuthbert: same model, same log, same run, same result.

A ring of masses, each pulled by its neighbours, half of them measured: linear, of any even
size; the nonlinear model adds a hardening spring. All libraries get the same discrete model
with additive noise and are compiled, filter and log likelihood included; `kedge` runs as a user
runs it, through its rig and log.
"""

import functools as ft
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.manifolds import Euclidean
from kedge.estimation.batch import compile_estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.parallel import _smooth as smooth_at_once
from kedge.estimation.rig import Installation, Rig, as_arrays
from kedge.estimation.smoother import smooth

dynamax = pytest.importorskip("dynamax", reason="pip install -e .[rivals]")
pytest.importorskip("cuthbert", reason="pip install -e .[rivals]")

pytestmark = pytest.mark.filterwarnings("ignore")  # dynamax imports what JAX will remove
EVENTS, DT, PUSH, STD = 300, 0.1, 0.3, 0.5


@ft.cache
def ring(size, hard):
    """Vehicle, sensor and prior of a ring whose state has ``size`` components."""
    half = size // 2
    vector = Annotated[Any, Euclidean("1", (half,))]

    class State(NamedTuple):
        place: vector
        pace: vector

    class Noise(NamedTuple):
        push: vector

    class Seen(NamedTuple):
        place: vector

    class Ring(AbstractVehicle):
        def step(self, state, control, noise, dt):
            place, pace = state
            pull = jnp.roll(place, 1) + jnp.roll(place, -1) - 2 * place - 0.5 * place
            if hard:
                pull = pull - 0.2 * place**3
            pace = pace + (pull - 0.3 * pace + noise.push) * dt
            return State(place + pace * dt, pace)

        def noise_density(self):
            return Noise(jnp.full(half, PUSH))

        def start(self):
            return State(jnp.ones(half), jnp.zeros(half))

        def nominal_control(self, time):
            return ()

    class Places(AbstractSensor):
        reads = Seen
        measures = Seen

        def observe(self, state):
            return Seen(state.place)

        def noise_std(self, state):
            return Seen(jnp.full(half, STD))

    prior = kedge.Gaussian(Ring().start(), 0.5 * jnp.eye(size))
    return Rig(Ring(), (Installation("places", Places()),), prior), Seen


def log_of(size, hard, events=EVENTS):
    """A simulated log: plain numpy, so that no library is favoured."""
    rig, Seen = ring(size, hard)
    random, state = np.random.default_rng(size), np.array(flat(rig.vehicle.start()))
    values, step = [], jax.jit(flat_step(rig))
    for _ in range(events):
        push = PUSH / np.sqrt(DT) * random.normal(size=size // 2)
        state = np.asarray(step(state, push))
        values.append(state[: size // 2] + STD * random.normal(size=size // 2))
    readings = Readings(Seen(jnp.asarray(np.array(values))), jnp.zeros(events, int))
    schedule = Schedule(
        DT * jnp.arange(1.0, events + 1), jnp.zeros(events, int), jnp.arange(events)
    )
    return rig, Log(schedule, (), (readings,)), np.array(values)


def flat(state):
    return jnp.concatenate([*state])


def flat_step(rig):
    State = type(rig.prior.mean)
    Noise = type(rig.vehicle.noise_density())

    def step(state, push):
        half = len(state) // 2
        after = rig.vehicle.step(State(state[:half], state[half:]), (), Noise(push), DT)
        return flat(after)

    return step


def matrices(rig, size):
    half, step = size // 2, flat_step(rig)
    F = jax.jacfwd(step)(jnp.ones(size), jnp.zeros(half))
    root = noise_root(rig, size)
    # Rivals factorise Q; a floor far below every figure compared makes it regular.
    Q = root @ root.T + 1e-12 * jnp.eye(size)
    H = jnp.eye(half, size)
    return F, Q, H, STD**2 * jnp.eye(half)


def noise_root(rig, size):
    half, step = size // 2, flat_step(rig)
    G = jax.jacfwd(step, argnums=1)(jnp.ones(size), jnp.zeros(half))
    return G * PUSH / np.sqrt(DT)


def by_dynamax(rig, size, values, rule):
    """Jitted; the first state of dynamax is at the first reading, so it starts predicted."""
    from dynamax.linear_gaussian_ssm import inference
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM
    from dynamax.nonlinear_gaussian_ssm.inference_ekf import extended_kalman_filter
    from dynamax.nonlinear_gaussian_ssm.inference_ukf import (
        UKFHyperParams,
        unscented_kalman_filter,
    )

    F, Q, H, R = matrices(rig, size)
    half, step = size // 2, flat_step(rig)
    first = kedge.make_filter(rule if rule != "kalman" else "extended").predict(
        rig.vehicle, rig.prior, (), DT, jax.random.key(0)
    )
    mean, cov = flat(first.mean), first.cov
    if rule == "kalman":
        zero = jnp.zeros((size, 0))
        params = inference.ParamsLGSSM(
            inference.ParamsLGSSMInitial(mean, cov),
            inference.ParamsLGSSMDynamics(F, jnp.zeros(size), zero, Q),
            inference.ParamsLGSSMEmissions(H, jnp.zeros(half), jnp.zeros((half, 0)), R),
        )
        run = jax.jit(lambda y: inference.lgssm_filter(params, y))
    else:
        params = ParamsNLGSSM(
            mean, cov, lambda x: step(x, jnp.zeros(half)), Q, lambda x: x[:half], R
        )
        fields = ["filtered_means", "filtered_covariances"]
        if rule == "extended":
            run = jax.jit(lambda y: extended_kalman_filter(params, y, output_fields=fields))
        else:
            hyper = UKFHyperParams(alpha=1.0, beta=0.0, kappa=1.0)
            run = jax.jit(
                lambda y: unscented_kalman_filter(params, y, hyper, output_fields=fields)
            )
    values = jnp.asarray(values)

    def call():
        found = jax.block_until_ready(run(values))
        return found.filtered_means[-1], found.marginal_loglik

    return call


def by_cuthbert(rig, size, values, rule):
    """Square roots throughout; jitted like the others."""
    from cuthbert import filtering
    from cuthbert.gaussian import kalman, moments

    F, Q, H, R = matrices(rig, size)
    half, step = size // 2, flat_step(rig)
    root_Q = jnp.linalg.cholesky(Q)
    root_R, root_P = jnp.sqrt(R), jnp.linalg.cholesky(rig.prior.cov)
    mean = flat(rig.prior.mean)
    values = jnp.asarray(values)
    if rule == "kalman":
        built = kalman.build_filter(
            mean,
            root_P,
            lambda k: (F, jnp.zeros(size), root_Q),
            lambda k: (H, jnp.zeros(half), root_R, values[k]),
        )
    else:
        built = moments.build_filter(
            mean,
            root_P,
            lambda state, k: (lambda x: (step(x, jnp.zeros(half)), root_Q), state.mean),
            lambda state, k: (lambda x: (x[:half], root_R), state.mean, values[k]),
        )
    inputs = jnp.arange(len(values))

    @jax.jit
    def run(inputs):
        return filtering.filter(built, inputs, built.init_prepare())

    def call():
        found = jax.block_until_ready(run(inputs))
        return found.mean[-1], found.log_normalizing_constant[-1]

    return call


def compare(times, rule, size, rivals):
    hard = rule != "kalman"
    rig, log, values = log_of(size, hard)
    call = compile_estimate(kedge.make_filter(rule), rig, log, keep=False)
    (found, _), ours = times.best(lambda: jax.block_until_ready(call()), 15)
    last = flat(jax.tree.map(lambda leaf: leaf[-1], found.moments.mean))
    total = float(found.outcome.log_likelihood.sum())
    for name, rival in rivals.items():
        answer = rival(rig, size, values, rule)
        answer()
        (mean, likelihood), theirs = times.best(answer, 15)
        # As good: the same mean, and (for sigma points, whose noise may enter elsewhere, to
        # first order of what the noise bends) the same log likelihood.
        loose = 1e-2 if rule == "unscented" else 1e-6
        np.testing.assert_allclose(mean, last, atol=loose)
        np.testing.assert_allclose(float(likelihood), total, rtol=loose)
        times.row(f"{rule}, state of {size}", name, theirs / EVENTS, ours / EVENTS, 1)


@pytest.mark.parametrize("size", [2, 4, 8, 16, 40])
def test_kalman(times, size):
    compare(times, "kalman", size, {"dynamax": by_dynamax, "cuthbert": by_cuthbert})


@pytest.mark.parametrize("size", [2, 4, 8, 16, 40])
def test_extended(times, size):
    compare(times, "extended", size, {"dynamax": by_dynamax, "cuthbert": by_cuthbert})


@pytest.mark.parametrize("size", [2, 4, 8, 16, 40])
def test_unscented(times, size):
    compare(times, "unscented", size, {"dynamax": by_dynamax})


@pytest.mark.parametrize("events", [1_000, 20_000])
def test_all_at_once(times, events):
    """The sequential scan and smoother beside the associative scan, here on few cores."""
    rig, log, _ = log_of(4, False, events)
    one = jax.jit(lambda log: smooth(kedge.make_filter("kalman"), rig, log))
    arguments = (*as_arrays((rig, log)), 0, None)
    for call in (lambda: one(log), lambda: smooth_at_once(*arguments)):
        jax.block_until_ready(call())
    expected, scan = times.best(lambda: jax.block_until_ready(one(log)), 5)
    found, tree = times.best(lambda: jax.block_until_ready(smooth_at_once(*arguments)), 5)
    for some, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(some.moments.cov, other.moments.cov, atol=1e-9)
    times.note(
        f"filter and smoother of {events} events on {jax.default_backend()}: one after the "
        f"other {scan * 1e3:.1f} ms, all at once {tree * 1e3:.1f} ms ({scan / tree:.2f}x)"
    )
