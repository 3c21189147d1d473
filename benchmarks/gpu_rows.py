"""What a GPU is good for, beside the CPU of the same machine: run with PYTHONPATH=src.

Needs jax, equinox, jaxtyping, numpy and platformdirs; takes less than four minutes. Each row is
the best of three runs, compiling apart; what would begin too late is
left out and said so.
"""

import contextlib
import time

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

import kedge
from kedge.estimation.log import Log
from kedge.estimation.rig import as_arrays
from kedge.estimation.traced import pass_over
from kedge.numerics.linalg import cholesky, gain, symmetric, triangularise
from kedge.numerics.random import normals
from kedge.simulation.simulate import schedule, simulate, with_readings

BUDGET = 210.0  # s for all of it
BEGUN = time.perf_counter()


def best(call, *arguments):
    """Seconds of a call compiled before, and of the compiling."""
    begin = time.perf_counter()
    jax.block_until_ready(call(*arguments))
    first = time.perf_counter() - begin
    found = []
    for _ in range(3):
        begin = time.perf_counter()
        jax.block_until_ready(call(*arguments))
        found.append(time.perf_counter() - begin)
    return min(found), first


def row(name, unit, count, make):
    """Time per ``unit`` on every device, if there is time left."""
    cells = []
    for device in devices():
        if time.perf_counter() - BEGUN > BUDGET:
            cells.append(f"{device.platform} not run: out of time")
            continue
        with jax.default_device(device):
            try:
                call, arguments = make()
                seconds, first = best(call, *arguments)
            except Exception as error:  # one row must not cost the others
                cells.append(f"{device.platform} {type(error).__name__}: {str(error)[:80]}")
                continue
        cells.append(f"{device.platform} {seconds / count * 1e9:.3f} ns (first {first:.1f} s)")
    print(f"{name:48s} per {unit:12s} " + "   ".join(cells), flush=True)


def devices():
    found = [jax.devices()[0]]
    if found[0].platform != "cpu":
        with contextlib.suppress(RuntimeError):
            found.append(jax.devices("cpu")[0])
    return found


def draws(dtype, ours):
    def make():
        size = 2**24
        draw = normals if ours else jr.normal
        call = jax.jit(lambda key: jnp.sum(draw(key, (size,), dtype)))
        return call, (jr.key(0),)

    return make


def updates(size, dtype, root):
    """Many measurement updates of half the state in a row: Joseph's form or triangular."""
    runs, steps, seen = 4096, 20, max(size // 2, 1)

    def make():
        H = jnp.eye(seen, size, dtype=dtype)
        Q, R = 0.01 * jnp.eye(size, dtype=dtype), jnp.eye(seen, dtype=dtype)

        def joseph(P, _):
            P = symmetric(P) + Q
            S = H @ P @ H.T + R
            K = gain(P @ H.T, cholesky(S))
            A = jnp.eye(size, dtype=dtype) - K @ H
            return symmetric(A @ P @ A.T + K @ R @ K.T), None

        def triangular(L, _):
            L = triangularise(jnp.concatenate([L, Q], axis=1))
            upper = jnp.concatenate([R, H @ L], axis=1)
            lower = jnp.concatenate([jnp.zeros((size, seen), dtype), L], axis=1)
            whole = triangularise(jnp.concatenate([upper, lower]))
            return whole[seen:, seen:], None

        step = triangular if root else joseph
        start = jnp.tile(jnp.eye(size, dtype=dtype), (runs, 1, 1))
        call = jax.jit(
            jax.vmap(lambda P: jnp.sum(jax.lax.scan(step, P, None, length=steps)[0]))
        )
        return call, (start,)

    return make, runs * steps


def extended(runs):
    """The unicycle of benchmarks/bench_extended.py for 10 s."""
    vehicle = kedge.make_vehicle("unicycle", speed_noise=0.1, yaw_rate_noise=0.02)
    camera = kedge.make_sensor("landmarks", range_std=0.5, bearing_std=0.02)
    gnss = kedge.make_sensor("gnss", std=1.0)
    installed = kedge.Installation("camera", camera), kedge.Installation("gnss", gnss)
    prior = kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(3))
    return study(kedge.Rig(vehicle, installed, prior), "extended", {}, runs, 10.0)


def ensemble(runs, count):
    """Paper A's model: 200 runs of 500 members are its largest case."""
    vehicle = kedge.make_vehicle("discrete-white-acceleration", acceleration_std=0.1**0.5)
    sensor = kedge.make_sensor("position-velocity", position_std=0.5, velocity_std=0.05)
    prior = kedge.Gaussian(vehicle.start(), jnp.diag(jnp.array([1.0, 1.0, 0.5, 0.5])))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", sensor, rate=10.0),), prior)
    return study(rig, "ensemble", {"count": count}, runs, 10.0)


def study(rig, name, parameters, runs, duration):
    scenario = kedge.Scenario(rig, duration)
    plan = schedule(scenario, output_rate=1e-3)
    events = len(plan.stamps)

    def make():
        filter, own, shared = as_arrays(
            (kedge.make_filter(name, **parameters), rig, plan.log.schedule)
        )

        def one(run):
            true = simulate(scenario, jr.fold_in(jr.key(1), run))
            log = with_readings(plan.log, scenario, true)
            log = Log(shared, log.controls, log.readings)
            found = pass_over(filter, own, log, jr.fold_in(jr.key(2), run), False)[0]
            return jax.tree.map(lambda leaf: leaf[-1], found.moments.mean)

        return jax.jit(jax.vmap(one)), (jnp.arange(runs),)

    return make, runs * events


def main():
    print("jax", jax.__version__, "numpy", np.__version__, *devices())
    for dtype in (jnp.float32, jnp.float64):
        for ours in (True, False):
            label = "kedge" if ours else "jax.random"
            row(f"normals, {label}, {dtype.__name__}", "number", 2**24, draws(dtype, ours))
    for runs in (1_000, 100_000):
        make, count = extended(runs)
        row(f"extended, {runs} runs, with simulation", "run-event", count, make)
    make, count = ensemble(200, 500)
    row("ensemble N 500, 200 runs, with simulation", "run-event", count, make)
    for size in (4, 15):
        for dtype in (jnp.float32, jnp.float64):
            for root in (False, True):
                label = "square root" if root else "Joseph"
                make, count = updates(size, dtype, root)
                row(f"{label}, {size} states, {dtype.__name__}", "update", count, make)


if __name__ == "__main__":
    main()
