"""What a GPU gains over the same machine's CPU, on the same arrays: skipped without one.

``pytest benchmarks/bench_accelerator.py``; needs JAX with its CUDA plugin, pytest, and nothing
that is not a dependency of kedge. Times are the best of a few, after compiling.
"""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import kedge
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.parallel import estimate_in_parallel
from kedge.filters.gaussian.square_root import SquareRootKalman
from kedge.numerics.random import normals
from kedge.sensors.landmarks import Landmark, Landmarks, Measurement
from kedge.vehicles.unicycle import Control, Unicycle

pytestmark = pytest.mark.gpu
STEPS, BATCH = 50, 100_000


def cast(tree, dtype):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), tree)


def both(times, make):
    """Best seconds by device of what ``make()`` returns: a function and its arguments."""
    found = {}
    for kind in ("cpu", "gpu"):
        with jax.default_device(jax.devices(kind)[0]):
            call, *arguments = make()
            jax.block_until_ready(call(*arguments))
            found[kind] = times.best(
                lambda c=call, a=arguments: jax.block_until_ready(c(*a)), 3
            )
    (_, cpu), (_, gpu) = found.values()
    return cpu, gpu, [np.asarray(jax.tree.leaves(result)[0]) for result, _ in found.values()]


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32], ids=["64", "32"])
def test_normals(times, dtype):
    count, bits = 10_000_000, jnp.finfo(dtype).bits
    for name, draw in (("kedge", normals), ("jax.random", jr.normal)):
        cpu, gpu, _ = both(
            times, lambda d=draw: (jax.jit(lambda key: d(key, (count,), dtype)), jr.key(0))
        )
        times.note(
            f"normals by {name}, float{bits}: CPU {cpu / count * 1e9:.2f} ns, "
            f"GPU {gpu / count * 1e9:.3f} ns a number ({cpu / gpu:.0f}x)"
        )


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32], ids=["64", "32"])
def test_forms(times, dtype):
    """Prediction and update of a unicycle that sees a landmark."""
    control, seen = cast((Control(1.0, 0.1), Measurement(6.0, 0.5)), dtype)
    sensor = Landmarks(target=Landmark(jnp.array([[5.0, 4.0]], dtype))).for_target(0)
    prior, dt, key = (
        kedge.Gaussian(Unicycle().start(), 0.1 * jnp.eye(3)),
        jnp.asarray(0.1, dtype),
        jr.key(0),
    )
    plain, bits = kedge.make_filter("extended"), jnp.finfo(dtype).bits
    for form, filter in (("covariance", plain), ("square root", SquareRootKalman(plain))):

        def run(first, filter=filter):
            def cycle(belief, _):
                belief = filter.predict(Unicycle(), belief, control, dt, key)
                return filter.update(sensor, belief, seen, key)[0], None

            return jax.lax.scan(cycle, filter.init(first, key), length=STEPS)[0].moments().mean

        def make(run=run):
            many = jax.tree.map(
                lambda leaf: jnp.broadcast_to(leaf, (BATCH, *leaf.shape)), cast(prior, dtype)
            )
            return jax.jit(jax.vmap(run)), many

        cpu, gpu, (one, other) = both(times, make)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 if bits == 64 else 1e-2)
        cpu, gpu = (s / STEPS / BATCH * 1e9 for s in (cpu, gpu))
        times.note(
            f"extended, {form}, float{bits}, {BATCH:,} runs: CPU {cpu:.0f} ns, "
            f"GPU {gpu:.1f} ns a step and run ({cpu / gpu:.1f}x)"
        )


def paper_a(runs, steps):
    """A rig and the logs of many runs: constant velocity, position and velocity measured."""
    vehicle = kedge.make_vehicle("discrete-white-acceleration", acceleration_std=0.1**0.5)
    sensor = kedge.make_sensor("position-velocity", position_std=0.5, velocity_std=0.05)
    prior = kedge.Gaussian(vehicle.start(), jnp.diag(jnp.array([1.0, 1.0, 0.5, 0.5])))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", sensor),), prior)
    noise = np.random.default_rng(0).standard_normal((2, runs, steps, 2))
    measured = sensor.measures(jnp.asarray(0.5 * noise[0]), jnp.asarray(0.05 * noise[1]))
    schedule = Schedule(
        0.1 * jnp.arange(1, steps + 1), jnp.zeros(steps, int), jnp.arange(steps)
    )
    controls = jax.tree.map(
        lambda leaf: jnp.full((runs, steps), leaf), vehicle.nominal_control(0.0)
    )
    readings = (Readings(measured, jnp.zeros((runs, steps), int)),)
    return rig, Log(schedule, controls, readings)


@pytest.mark.parametrize(
    ("name", "runs"),
    [("kalman", 20_000), ("ensemble:count=500", 200), ("particle:count=5000", 200)],
)
def test_paper_a(times, name, runs):
    """All runs of a study in one batch, 100 steps."""
    steps, (kind, *parameters) = 100, name.split(":")
    count = {key: int(value) for key, _, value in (p.partition("=") for p in parameters)}
    filter = kedge.make_filter(kind, **count)

    def make():
        rig, log = paper_a(runs, steps)
        chunk = runs if jax.config.jax_default_device.platform == "gpu" else 125
        return (
            lambda: kedge.estimate_runs(
                filter, rig, log, keep=lambda e: e.moments.mean.position[-1], chunk=chunk
            ),
        )

    cpu, gpu, (one, other) = both(times, make)
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    times.note(
        f"{name}, {runs:,} runs x {steps} steps: CPU {cpu:.2f} s, GPU {gpu:.2f} s "
        f"({cpu / gpu:.1f}x)"
    )


def test_one_long_log(times):
    """Many events by an associative scan, and one after the other."""
    steps = 200_000
    for form, estimate in (
        ("associative scan", estimate_in_parallel),
        (
            "one after the other",
            lambda rig, log: kedge.estimate(kedge.make_filter("kalman"), rig, log),
        ),
    ):
        if form != "associative scan":
            steps = 5_000  # a GPU starts its kernels for each event

        def make(estimate=estimate, steps=steps):
            rig, log = paper_a(1, steps)
            log = log._replace(
                controls=jax.tree.map(lambda leaf: leaf[0], log.controls),
                readings=jax.tree.map(lambda leaf: leaf[0], log.readings),
            )
            return (lambda: estimate(rig, log).moments.mean.position,)

        cpu, gpu, (one, other) = both(times, make)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6)
        times.note(
            f"Kalman, {form}, {steps:,} events: CPU {cpu / steps * 1e6:.2f} us, "
            f"GPU {gpu / steps * 1e6:.3f} us an event ({cpu / gpu:.1f}x)"
        )
