"""What errors with a memory cost, and what each way to treat them is worth: simulated laws.

    python examples/correlated_errors.py [--runs N]

A vehicle at nearly constant velocity has fixes once a second. Their error has a white part of
0.5 m and one of 1 m that lasts for the time in the first column. Each filter and its smoother
is told of the error as the second column says. Printed, as Markdown, over all runs and times:
RMSE of the position, the share of errors inside the 95 % bound, and NEES by dimension.
"""

import argparse
import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from kedge import Gaussian, Installation, Rig, make_filter, use_compilation_cache, with_errors
from kedge.estimation.correlated_error import CorrelatedError
from kedge.estimation.smoother import smooth
from kedge.evaluation.consistency import chi_square_bound
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.vehicles.constant_velocity import ConstantVelocity

WHITE, LASTING = 0.5, 1.0  # m
FIRST = 10.0  # s; what is before is left out, since it hangs on the prior


class Figures(NamedTuple):
    """Of a filter or a smoother, over runs and times."""

    rmse: float
    coverage: float
    nees: np.ndarray
    """By dimension, of each run and time."""


def rig_of(error: CorrelatedError | None, std: float = WHITE) -> Rig:
    """The vehicle with its receiver of fixes."""
    vehicle = ConstantVelocity(acceleration_noise=0.3)
    gnss = Installation("gnss", Gnss(std=std), rate=1.0, error=error)
    return with_errors(Rig(vehicle, (gnss,), Gaussian(vehicle.start(), jnp.eye(4))))


def treatments(tau: float) -> Iterator[tuple[str, Rig]]:
    """What filters are told of an error that lasts for ``tau`` s."""
    right = CorrelatedError(LASTING, tau)
    yield "white, of the same spread", rig_of(None, float(np.hypot(WHITE, LASTING)))
    for treatment in ("estimated", "considered", "widened"):
        yield treatment, rig_of(dataclasses.replace(right, treatment=treatment))
    considered = dataclasses.replace(right, treatment="considered")
    for factor, name in ((0.5, "half"), (2.0, "twice")):
        yield (
            f"considered, {name} the deviation",
            rig_of(dataclasses.replace(considered, std=factor * LASTING)),
        )
        yield (
            f"considered, {name} the time",
            rig_of(dataclasses.replace(considered, time_constant=factor * tau)),
        )


def figures(truth: Rig, told: Rig, runs: int, seconds: float) -> tuple[Figures, Figures]:
    """Of filter and smoother, over runs in which the truth is ``truth``."""
    scenario = Scenario(truth, duration=seconds, dt=0.5)
    plan = schedule(scenario, output_rate=0.2)
    times = np.asarray(plan.log.schedule.time)
    step = np.round(times / scenario.dt).astype(int) - 1
    judged = times >= FIRST

    @jax.jit
    @jax.vmap
    def one(key: Any) -> Any:
        run = simulate(scenario, key)
        estimates = smooth(
            make_filter("extended"), told, with_readings(plan.log, scenario, run)
        )
        true = run.truth.position[step]
        return [(true - e.moments.mean.position, e.moments.cov[:, :2, :2]) for e in estimates]

    pair = []
    for error, cov in one(jr.split(jr.key(11), runs)):
        error, cov = np.asarray(error)[:, judged], np.asarray(cov)[:, judged]
        white = np.linalg.solve(cov, error[..., None])[..., 0]
        nees = np.sum(error * white, axis=-1)
        coverage = float(np.mean(nees <= chi_square_bound(2, 0.95)))
        rmse = float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))
        pair.append(Figures(rmse, coverage, nees / 2))
    return pair[0], pair[1]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    options = parser.parse_args()
    use_compilation_cache()
    print("| lasts | filter is told | RMSE m | in 95 % bound | NEES/dof | smoother | | |")
    print("|---" * 8 + "|")
    for tau in (0.5, 3.0, 10.0, 30.0):
        truth = rig_of(CorrelatedError(LASTING, tau))
        for name, told in treatments(tau):
            cells = [
                f"{f.rmse:.2f} | {100 * f.coverage:.0f} % | {f.nees.mean():.2f}"
                for f in figures(truth, told, options.runs, 120.0)
            ]
            print(f"| {tau:g} s | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
