"""How sure the shipped rigs are and how right, on every recorded run below KEDGE_DATA.

    python examples/honesty.py [SET ...] [--until SECONDS] [--rig RIG] [--set KEY=VALUE ...]
                               [--filter NAME] [--no-smooth] [--as-shipped]

Prints a table, as Markdown: set, run, what its numbers were tuned on, filter, position RMSE,
the share of position errors inside the 95 % bound, and NEES by dimension, of the position and
of all that truth knows. A star marks what is outside the bounds: coverage of 88 to 99 % (a
smoother: at least 85 %), NEES by dimension below 1.6. A rig whose numbers come from a
calibration is scored on each run with the calibration of the others; "--as-shipped" takes the
rig's own.
"""

import argparse
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from auv_dead_reckoning import calibration, typical

from kedge import KedgeError, Problem, load_problem, run_filters, use_compilation_cache
from kedge.apps.workflow import SMOOTHER, settings, with_smoothers
from kedge.evaluation.scores import FilterScores

COVERAGE, OF_SMOOTHERS, NEES = (0.88, 0.99), 0.85, 1.6
LARGE = 2e9  # bytes of covariances that a smoother may keep


class Recorded(NamedTuple):
    """The recorded runs of one rig."""

    rig: str
    tuned_on: str
    logs: dict[str, str]
    """By run: where it is below KEDGE_DATA."""


DRIVES = [f"{sight}/Trajectory_A/Case_{case}" for sight in ("LOS", "NLOS") for case in (1, 2)]
SETS = {
    "hanyang": Recorded(
        "hanyang_uwb",
        "static readings; these drives",
        {
            f"{run.split('/')[0]} {run[-1]}": f"hanyang_uwb/Dynamic_measurements#{run}"
            for run in DRIVES
        },
    ),
    "mrclam": Recorded(
        "mrclam",
        "these robots",
        {f"robot {n}": f"mrclam/MRCLAM_Dataset7#{n}" for n in range(1, 6)},
    ),
    "plaza": Recorded("plaza", "this drive", {"1": "plaza/Plaza1_.mat"}),
    "akit": Recorded(
        "auv_akit_snapir",
        "the others; error: these runs",
        {str(n): f"auv_akit_snapir#{n}" for n in range(1, 8)},
    ),
    "isas": Recorded("isas_walk", "this walk", {"walk 1": "isas_walk/walk1.bag"}),
    "lias": Recorded("lias_trolley", "this drive", {"fast": "lias_trolley"}),
    "starloc": Recorded("starloc", "this drive", {"loop": "starloc/loop-2d-fast_s1"}),
    "labyrinth": Recorded("labyrinth", "nothing", {"indoor": "labyrinth/Indoor_UWB"}),
}


def of_the_others(root: Path, logs: dict[str, str]) -> dict[str, dict[str, str]]:
    """By run of the Snapir: its Doppler log as the other runs calibrate it."""
    each = {run: calibration(str(root / log)) for run, log in logs.items()}
    return {
        run: typical([c for other, c in each.items() if other != run]).overrides("dvl")
        for run in logs
    }


def problems(
    root: Path, options: argparse.Namespace
) -> Iterator[tuple[str, str, str, Problem | KedgeError]]:
    """Set, run, what its rig was tuned on, and the rig on the log."""
    for name in options.sets or SETS:
        rig, tuned_on, logs = SETS[name]
        known: dict[str, dict[str, str]] = {}
        if name == "akit":
            if options.as_shipped:
                tuned_on = "these runs"
            elif (root / "auv_akit_snapir").exists():
                known = of_the_others(root, logs)
        for run, log in logs.items():
            changes = known.get(run, {}) | settings(options.changes)
            where = options.rig or rig, str(root / log)
            try:
                problem = load_problem(*where, until=options.until, overrides=changes)
            except KedgeError as error:
                problem = error
            yield name, run, tuned_on, problem


def filters(problem: Problem, options: argparse.Namespace) -> Sequence[str]:
    """The rig's filter, and its smoother where that can be kept."""
    name = options.filter or problem.filter
    size = problem.rig.prior.cov.shape[0]
    kept = 3 * 8 * size**2 * len(problem.recording.stamps)
    return [name] if options.no_smooth or kept > LARGE else with_smoothers([name])


def row(name: str, scores: FilterScores) -> str:
    """RMSE, coverage and NEES of one filter, and stars at what is outside the bounds."""
    dof = 3 if "position_z" in scores.rmse else 2
    share = scores.coverage_95["position"]
    low, high = (OF_SMOOTHERS, 1.0) if name.endswith(SMOOTHER) else COVERAGE
    figures = [
        f"{scores.rmse['position']:.3f}",
        f"{100 * share:.1f} %{'' if low <= share <= high else ' *'}",
    ]
    for nees, size in (
        (scores.nees_by_field["position"], dof),
        (scores.nees, scores.nees_dof),
    ):
        ratio = float("nan") if nees is None or not size else nees / size
        figures.append(f"{ratio:.2f}{'' if ratio < NEES else ' *'}")
    return " | ".join(figures)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", metavar="SET", choices=[[], *SETS])
    parser.add_argument("--until", type=float)
    parser.add_argument("--rig", help="instead of the shipped one")
    parser.add_argument("--set", dest="changes", action="append", metavar="KEY=VALUE")
    parser.add_argument("--filter", help="instead of the rig's own")
    parser.add_argument("--no-smooth", action="store_true")
    parser.add_argument("--as-shipped", action="store_true")
    options = parser.parse_args()
    use_compilation_cache()
    root = Path(os.environ.get("KEDGE_DATA", "."))
    titles = ["set", "run", "tuned on", "filter", "RMSE m", "in 95 % bound"]
    titles += ["NEES/dof position", "NEES/dof all"]
    print(f"| {' | '.join(titles)} |\n{'|---' * len(titles)}|")
    for name, run, tuned_on, problem in problems(root, options):
        start = f"| {name} | {run} | {tuned_on} |"
        if isinstance(problem, KedgeError):
            print(f"{start} | {problem} | | | |", flush=True)
            continue
        for scored in run_filters(problem, filters(problem, options), 0, lambda _: None):
            print(f"{start} {scored.name} | {row(scored.name, scored.scores)} |", flush=True)


if __name__ == "__main__":
    main()
