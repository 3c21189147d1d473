"""Ensemble filters beside DAPPER: same model, same readings, same machine, same run.

DAPPER pins other packages than kedge does, so it runs as a program in an environment of its
own: ``build/dapper``, made here if the network allows, or the interpreter named by
``KEDGE_DAPPER``. Neither side keeps covariances or diagnostics.
"""

import json
import math
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.conftest import interpreter

import kedge
from kedge.estimation.log import Log, Readings, Schedule

DAPPER = "dapper==1.7.1"
SCRIPT = Path(__file__).with_name("dapper_cycles.py")
# Size, members, filter, DAPPER's name for it, radius of localisation, cycles.
CASES = [
    (3, 10, "etkf", "Sqrt", None, 400),
    (3, 100, "etkf", "Sqrt", None, 400),
    (3, 100, "ensemble", "PertObs", None, 400),
    (40, 24, "etkf", "Sqrt", None, 400),
    (40, 100, "etkf", "Sqrt", None, 200),
    (40, 40, "ensemble", "PertObs", None, 400),
    (40, 40, "denkf", "DEnKF", None, 400),
    (40, 28, "serial-enkf", "Serial", None, 200),
    (40, 10, "etkf", "Sqrt", 14.6, 200),
    (400, 40, "etkf", "Sqrt", None, 20),
    (400, 100, "ensemble", "PertObs", None, 20),
    (400, 10, "etkf", "Sqrt", 14.6, 20),
    (1000, 40, "etkf", "Sqrt", None, 10),
    (1000, 100, "ensemble", "PertObs", None, 10),
    (1000, 10, "etkf", "Sqrt", 14.6, 10),
]


@pytest.fixture(scope="module")
def dapper():
    """The interpreter of an environment with DAPPER."""
    return interpreter(DAPPER)


def world(size, cycles):
    """A vehicle, a sensor of all components, the truth and its readings."""
    if size == 3:
        vehicle, std, dt = kedge.make_vehicle("lorenz63", substeps=25), math.sqrt(2), 0.25
    else:
        vehicle, std, dt = kedge.make_vehicle("lorenz96", size=size), 1.0, 0.05
    sensor = kedge.make_sensor("components", size=size, std=std)
    start = vehicle.start()
    calm = type(start)(jnp.zeros(size))

    def step(state, _):
        state = vehicle.step(state, vehicle.nominal_control(0.0), calm, dt)
        return state, state.values

    rng = np.random.default_rng(1)
    rough = type(start)(start.values + jnp.asarray(rng.normal(size=size)))
    _, path = jax.jit(lambda s: jax.lax.scan(step, s, length=200 + cycles))(rough)
    path = np.asarray(path)
    first, truth = path[199], path[200:]
    return vehicle, sensor, dt, std, first, truth, truth + std * rng.normal(size=truth.shape)


def ours(filter, vehicle, sensor, dt, first, start_std, readings):
    """Seconds a cycle, and the means."""
    cycles, size = readings.shape
    state = type(vehicle.start())
    prior = kedge.Gaussian(state(jnp.asarray(first)), start_std**2 * jnp.eye(size))
    rig = kedge.Rig(vehicle, (kedge.Installation("all", sensor),), prior)
    times = dt * np.arange(1, cycles + 1)
    schedule = Schedule(times, np.zeros(cycles, int), np.arange(cycles))
    rows = Readings(sensor.measures(readings[None]), np.zeros((1, cycles), int))
    controls = jax.tree.map(
        lambda leaf: jnp.full((1, cycles), leaf), vehicle.nominal_control(0.0)
    )
    log = Log(schedule, controls, (rows,))

    def run():
        found = kedge.estimate_runs(filter, rig, log, keep=means)
        return np.asarray(found)[0]

    run()
    return run, cycles


def means(estimates):
    return estimates.moments.mean.values


@pytest.mark.parametrize("case", CASES, ids=lambda c: "-".join(map(str, c)))
def test_cycle(case, dapper, times):
    size, count, name, method, radius, cycles = case
    inflation = 1.04 if radius else 1.06 if name == "ensemble" else 1.02
    rotation = name in ("etkf", "serial-enkf")
    vehicle, sensor, dt, std, first, truth, readings = world(size, cycles)
    parameters = {"count": count, "inflation": inflation, "rotation": rotation}
    filter = kedge.make_filter(name, **parameters, **({"radius": radius} if radius else {}))
    run, _ = ours(filter, vehicle, sensor, dt, first, 0.1, readings)
    repeats = 3 if size < 400 else 1
    found, seconds = times.best(run, repeats)
    theirs = {
        **parameters,
        **{"size": size, "method": method, "radius": radius, "dt": dt, "std": std},
        **{"substeps": 25 if size == 3 else 1, "start": first.tolist(), "start_std": 0.1},
        **{"truth": truth.tolist(), "readings": readings.tolist(), "repeats": repeats},
    }
    answer = subprocess.run(
        [dapper, SCRIPT], input=json.dumps([theirs]), capture_output=True, text=True, check=True
    )
    (rival,) = json.loads(answer.stdout)
    error = np.sqrt(np.mean((found - truth) ** 2, axis=1))[cycles // 3 :].mean()
    place = f", radius {radius:g}" if radius else ""
    what = f"{name}, {size} states, N {count}{place}"
    times.row(what, "DAPPER", rival["seconds"], seconds / cycles, at_least=1)
    times.note(f"{what}: RMSE {error:.3f}, DAPPER {rival['rmse']:.3f}")
