"""The recorded sets of ranges, each with its shipped rig, on one page of figures.

    python examples/recorded_ranges.py [NAME ...]

Prints, for each set that is below KEDGE_DATA: position RMSE and median error, the share of
errors inside the 95 % bound, for the rig's filter and, where it can be smoothed, its smoother;
for the mower ("plaza") also what becomes of outliers with a gate, robust losses and nothing.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from kedge import Problem, load_problem, run_filters, use_compilation_cache
from kedge.core.errors import DataError

HANYANG = "hanyang_uwb/Dynamic_measurements"
SETS = {
    "plaza": ("plaza", "plaza/Plaza1_.mat"),
    "labyrinth": ("labyrinth", "labyrinth/Indoor_UWB"),
    "lias_trolley": ("lias_trolley", "lias_trolley"),
    "hanyang LOS 1": ("hanyang_uwb", f"{HANYANG}#LOS/Trajectory_A/Case_1"),
    "hanyang LOS 2": ("hanyang_uwb", f"{HANYANG}#LOS/Trajectory_A/Case_2"),
    "hanyang NLOS 1": ("hanyang_uwb", f"{HANYANG}#NLOS/Trajectory_A/Case_1"),
    "hanyang NLOS 2": ("hanyang_uwb", f"{HANYANG}#NLOS/Trajectory_A/Case_2"),
    "isas_walk": ("isas_walk", "isas_walk/walk1.bag"),
    "starloc": ("starloc", "starloc/loop-2d-fast_s1"),
}
LARGE = ("lias_trolley",)  # its smoother would keep gigabytes
SHARE, LEAST, MEAN = 0.2, 5.0, 20.0  # of the ranges, lengthened by LEAST + Exp(MEAN) m

DEAD, PATIENCE, NEAR = 40.0, 200.0, 1.5  # s without odometer, s to be found again, m

NO_GATE = {"sensors.radio.gate": "1e-300"}
ROBUST = {
    "gate, recovery": {},
    "student": NO_GATE | {"sensors.radio.robust": '{loss="student"}'},
    "cauchy": NO_GATE | {"sensors.radio.robust": '{loss="cauchy"}'},
    "huber": NO_GATE | {"sensors.radio.robust": '{loss="huber"}'},
    "gate or Student": NO_GATE,
    "none": NO_GATE,
}


def quiet(text: str) -> None:
    """Say nothing."""


def figures(problem: Problem, names: Sequence[str]) -> list[tuple[str, Any]]:
    """By filter: RMSE, median error, share of errors inside the 95 % bound."""
    rows = []
    for run in run_filters(problem, names, 0, quiet):
        if run.errors is None:
            continue
        distance = np.linalg.norm(run.errors.error[:, run.errors.fields["position"]], axis=1)
        scores = run.scores
        rows.append(
            (
                run.name,
                f"{scores.rmse['position']:9.3f}{np.nanmedian(distance):9.3f}"
                f"{scores.coverage_95['position']:9.2f}",
            )
        )
    return rows


def spoilt(problem: Problem) -> Problem:
    """The same log with a fifth of its ranges much too long."""
    draws, recording = np.random.default_rng(1), problem.recording
    (readings,) = recording.log.readings
    value = np.asarray(readings.measurement.range)
    longer = LEAST + draws.exponential(MEAN, len(value))
    value = np.where(draws.random(len(value)) < SHARE, value + longer, value)
    measurement = type(readings.measurement)(jnp.asarray(value))
    log = recording.log._replace(readings=(readings._replace(measurement=measurement),))
    return problem._replace(recording=recording._replace(log=log))


def carried_away(problem: Problem, names: Sequence[str]) -> None:
    """At twelve times the odometer says for 40 s that it stands: who is found again?"""
    log = problem.recording.log
    at = np.asarray(log.schedule.time)
    for name in names:
        took = []
        for start in np.linspace(150.0, 1650.0, 12):
            dead = (at > start) & (at <= start + DEAD)
            controls = type(log.controls)(*(jnp.where(dead, 0.0, v) for v in log.controls))
            recording = problem.recording._replace(log=log._replace(controls=controls))
            (run,) = run_filters(problem._replace(recording=recording), [name], 0, quiet)
            off = np.linalg.norm(run.errors.error[:, run.errors.fields["position"]], axis=1)
            since = run.errors.time - start - DEAD
            late = since[(since < PATIENCE) & (since > -DEAD) & (off > NEAR)]
            took.append(max(float(late.max(initial=0.0)), 0.0))
        found = sum(seconds < PATIENCE - 5.0 for seconds in took)
        print(
            f"{'carried away':18s}{name:28s}found again {found} of {len(took)}, median "
            f"{np.median(took):.0f} s"
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", metavar="NAME", help=", ".join(SETS))
    chosen = parser.parse_args().sets or list(SETS)
    use_compilation_cache()
    root = Path(os.environ.get("KEDGE_DATA", "."))
    print(f"{'':18s}{'filter':24s}{'RMSE m':>9s}{'median m':>9s}{'in 95 %':>9s}")
    for name in chosen:
        rig, log = SETS[name]
        try:
            problem = load_problem(rig, str(root / log))
        except DataError as error:
            print(f"{name:18s}{error}")
            continue
        names = [problem.filter]
        if name == "plaza":
            names += ["extended", "extended+smoother"]
        elif problem.filter == "extended" and name not in LARGE:
            names += ["extended+smoother"]
        for filter, text in figures(problem, names):
            print(f"{name:18s}{filter:24s}{text}")
    if "plaza" not in chosen or not (root / SETS["plaza"][1]).exists():
        return
    print("\nplaza, extended filter:")
    log = str(root / SETS["plaza"][1])
    for what, change in (("as recorded", None), ("a fifth much too long", spoilt)):
        for name, overrides in ROBUST.items():
            problem = load_problem("plaza", log, overrides=overrides)
            problem = problem if change is None else change(problem)
            filter = "gate-or-student" if name == "gate or Student" else "extended"
            ((_, text),) = figures(problem, [filter])
            print(f"{what:24s}{name:18s}{text}")
    carried_away(
        load_problem("plaza", log), ["extended", "hypotheses", "hypotheses:inner=unscented"]
    )
    alone = "{speed_scale={std=0.05}, yaw_rate_scale={std=0.05}}"
    problem = load_problem("plaza", log, overrides=NO_GATE | {"vehicle.augmented": alone})
    ((_, text),) = figures(problem, ["extended"])
    print(f"{'no scale of the ranges':24s}{'none':18s}{text}")


if __name__ == "__main__":
    main()
