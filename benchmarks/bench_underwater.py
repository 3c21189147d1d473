"""The ensemble filter on the 6-DOF underwater vehicle: against real time, and against NumPy.

What is said of one core is measured by a process that may use but one. Where it has more, XLA's
threads hand small arrays to each other, and one log takes longer.
"""

import json
import os
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import kedge
from kedge.estimation.batch import compile_estimate
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.runs import estimate_runs
from kedge.numerics.noise import process_std
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.vehicles.underwater.accelerations import slope
from kedge.vehicles.underwater.hydrodynamics import FEATURES, features, response
from kedge.vehicles.underwater.underwater import DOWN, FLIP, Noise, Underwater

DT, SECONDS, MEMBERS, RUNS = 0.01, 60.0, 100, 50
AIM = 50.0
"""Times faster than real time, on one core."""


@pytest.fixture(scope="module", name="scenario")
def fixture():
    return scenario_of(SECONDS)


def scenario_of(seconds):
    """On the vehicle's own drive: what a filter costs does not depend on the way."""
    vehicle = Underwater()
    std = jnp.repeat(jnp.array([0.05, 0.02, 0.05, 0.02]), 3)
    sensors = (
        Installation("dvl", kedge.make_sensor("doppler"), rate=5.0),
        Installation("ahrs", kedge.make_sensor("attitude"), rate=10.0),
        Installation("gyro", kedge.make_sensor("gyroscope"), rate=10.0),
        Installation("depth", kedge.make_sensor("depth"), rate=5.0),
    )
    rig = Rig(vehicle, sensors, kedge.Gaussian(vehicle.start(), jnp.diag(std**2)))
    return Scenario(rig, seconds, DT)


def logs(scenario, runs):
    """Readings of some runs; the log asks for the estimate at every step."""
    plan = schedule(scenario, output_rate=1 / DT)
    found = jax.jit(jax.vmap(lambda key: simulate(scenario, key)))(jr.split(jr.key(0), runs))
    log = plan.log
    controls, readings = jax.vmap(
        lambda run: (lambda one: (one.controls, one.readings))(
            with_readings(log, scenario, run)
        )
    )(found)
    return log._replace(controls=controls, readings=readings)


def on_one_core():
    """The shortest pass over one log, s, by this process."""
    scenario = scenario_of(SECONDS)
    log = logs(scenario, 1)
    one = log._replace(
        controls=jax.tree.map(lambda leaf: leaf[0], log.controls),
        readings=jax.tree.map(lambda leaf: leaf[0], log.readings),
    )
    filter = kedge.make_filter("ensemble", count=MEMBERS)
    call = compile_estimate(filter, scenario.rig, one, keep=False)
    shortest = float("inf")
    for _ in range(5):
        before = time.perf_counter()
        jax.block_until_ready(call())
        shortest = min(shortest, time.perf_counter() - before)
    return shortest


def test_one_log_against_real_time(times):
    done = subprocess.run(
        [sys.executable, __file__], check=True, capture_output=True, text=True
    )
    seconds = json.loads(done.stdout.splitlines()[-1])
    row = "6-DOF, ensemble of 100, steps of 10 ms, one core"
    times.row(row, "real time", DT, seconds * DT / SECONDS, AIM)


def test_fifty_runs(scenario, times):
    log = logs(scenario, RUNS)
    filter = kedge.make_filter("ensemble", count=MEMBERS)

    def call():
        return estimate_runs(
            filter, scenario.rig, log, keep=lambda found: found.moments.mean.position
        )

    jax.block_until_ready(call())  # compiles
    _, wall = times.best(lambda: jax.block_until_ready(call()), 1)
    times.row("6-DOF, 50 runs of 60 s, ensemble of 100", "a minute", 60.0, wall, 1.0)


def numpy_step(vehicle):
    """The same step of all members at once: RK4, positions and quaternions included."""
    hull = vehicle.hull
    reply, place = np.asarray(response(hull)), {name: i for i, name in enumerate(FEATURES)}
    squares = slice(place["u|u|"], place["u|u|"] + 6)
    rest, limit = place["down_x"], float(hull.fin_limit)

    def rates(x, commands, shaken):
        velocity, position, (w, i, j, k) = x[:6], x[6:9], x[9:]
        del position
        up = [2 * (i * k - w * j), 2 * (j * k + w * i), w * w - i * i - j * j + k * k]
        turn = np.array(
            [
                [w * w + i * i - j * j - k * k, 2 * (i * j - w * k), 2 * (i * k + w * j)],
                [2 * (i * j + w * k), w * w - i * i + j * j - k * k, 2 * (j * k - w * i)],
                up,
            ]
        )
        known = np.empty((len(FEATURES), x.shape[1]))
        known[:36] = (velocity[:, None] * velocity[None]).reshape(36, -1)
        known[squares] = velocity * np.abs(velocity)
        known[rest : rest + 3] = DOWN[:, None] * np.array(up)
        known[rest + 3 : rest + 5] = commands[:2, None]
        known[rest + 5 :] = velocity[0] ** 2 * commands[2:, None]
        push = reply @ known + shaken
        body, (a, b, c) = FLIP[:3, None] * velocity[:3], FLIP[3:, None] * velocity[3:]
        moved = np.einsum("ijn,jn->in", turn, body)
        spin = 0.5 * np.array(
            [
                -i * a - j * b - k * c,
                w * a + j * c - k * b,
                w * b - i * c + k * a,
                w * c + i * b - j * a,
            ]
        )
        return np.concatenate([push, moved, spin])

    def step(x, control, noise, dt):
        fins = np.clip(control[2:], -limit, limit)
        commands, shaken = np.concatenate([control[:2], fins]), FLIP[:, None] * noise
        first = rates(x, commands, shaken)
        second = rates(x + dt / 2 * first, commands, shaken)
        third = rates(x + dt / 2 * second, commands, shaken)
        fourth = rates(x + dt * third, commands, shaken)
        x = x + dt / 6 * (first + 2 * (second + third) + fourth)
        x[9:] /= np.sqrt((x[9:] ** 2).sum(axis=0))
        return x

    return step


def test_the_dynamics_against_numpy(times):
    vehicle, steps = Underwater(), 500
    control = vehicle.nominal_control(1.0)
    std = np.asarray(process_std(vehicle, DT))
    white = std[None, :, None] * np.random.default_rng(0).normal(size=(steps, 6, MEMBERS))
    start = vehicle.start()
    first = np.concatenate([FLIP[:3] * start.velocity_body, np.zeros(3), *start[:2]])
    step, told = numpy_step(vehicle), np.array([float(part) for part in control])

    def rival():
        x = np.repeat(first[:, None], MEMBERS, axis=1)
        for noise in white:
            x = step(x, told, noise, DT)
        return x

    @jax.jit
    def ours(white):
        def body(states, noise):
            def one(state, noise):
                return vehicle.step(state, control, Noise(noise[:3], noise[3:]), DT)

            return jax.vmap(one)(states, noise.T), None

        states = jax.tree.map(lambda x: jnp.repeat(x[None], MEMBERS, axis=0), start)
        return jax.lax.scan(body, states, white)[0]

    given = jnp.asarray(white)
    found = jax.block_until_ready(ours(given))
    theirs, slow = times.best(rival, 3, time.process_time)
    _, quick = times.best(lambda: jax.block_until_ready(ours(given)), 3, time.process_time)
    np.testing.assert_allclose(found.position, theirs[6:9].T, atol=1e-9)
    np.testing.assert_allclose(found.velocity_body, FLIP[:3] * theirs[:3].T, atol=1e-9)
    row = "6-DOF dynamics, step of 100 members, one core"
    times.row(row, "NumPy", slow / steps, quick / steps)


def test_the_velocities_jacobian(times):
    reply, down = response(Underwater().hull), jnp.array([0.0, 0.0, 1.0])
    commands, count, repeats = jnp.array([3.86, 0.0, 0.05, 0.02]), 1000, 200
    points = 0.3 * jr.normal(jr.key(0), (count, 6))

    def automatic(velocity):
        return jax.jacfwd(lambda v: reply @ features(v, down, commands))(velocity)

    def repeated(rule):
        """Each time at another place, so that nothing can be lifted out of the loop."""

        @jax.jit
        def call(points):
            def body(at, _):
                found = jax.vmap(rule)(at)
                return at + 1e-6 * found[:, :, 0], None

            return jax.lax.scan(body, points, None, length=repeats)[0]

        return call

    exact, by_rule = repeated(lambda v: slope(reply, v, commands)), repeated(automatic)
    found = jax.vmap(lambda v: slope(reply, v, commands))(points)
    np.testing.assert_allclose(found, jax.vmap(automatic)(points), atol=1e-12)
    jax.block_until_ready((exact(points), by_rule(points)))
    _, slow = times.best(lambda: jax.block_until_ready(by_rule(points)), 5, time.process_time)
    _, quick = times.best(lambda: jax.block_until_ready(exact(points)), 5, time.process_time)
    row, each = "6-DOF velocities, exact Jacobian", count * repeats
    times.row(row, "automatic differentiation", slow / each, quick / each)


if __name__ == "__main__":
    # Before JAX counts the cores.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(json.dumps(on_one_core()))
