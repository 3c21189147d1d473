"""The five robots of MRCLAM dataset 7, one rig file, no tuning by robot.

    python examples/mrclam_robots.py [FOLDER] [--rig RIG] [--until SECONDS]

Prints, for each robot and in the mean: position and heading RMSE and the share of position
errors inside the 95 % bound, for dead reckoning, the extended filter and its smoother.
"""

import argparse

from kedge import load_problem, run_filters, use_compilation_cache
from kedge.datasets.fetch import require_located
from kedge.evaluation.scores import FilterScores

NAMES = ("dead-reckoning", "extended", "extended+smoother")


def scores_of(
    folder: str, robot: int, rig: str, until: float | None
) -> dict[str, FilterScores]:
    """What each filter reaches on one robot's log."""
    problem = load_problem(rig, f"{folder}#{robot}", until=until)
    runs = run_filters(problem, NAMES, seed=0, progress=lambda text: None)
    return {run.name: run.scores for run in runs}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?")
    parser.add_argument("--rig", default="mrclam")
    parser.add_argument("--until", type=float)
    options = parser.parse_args()
    use_compilation_cache()
    folder = options.folder or str(require_located("mrclam"))
    rows = {
        robot: scores_of(folder, robot, options.rig, options.until) for robot in range(1, 6)
    }
    print(f"{'robot':20s}" + "".join(f"{robot:9d}" for robot in rows) + f"{'mean':>9s}")
    for name in NAMES:
        for label, pick in (
            ("position RMSE m", lambda s: s.rmse["position"].value),
            ("heading RMSE rad", lambda s: s.rmse["heading"].value),
            ("in 95 % bound", lambda s: s.coverage_95["position"]),
        ):
            values = [pick(row[name]) for row in rows.values()]
            print(f"{label:20s}" + "".join(f"{v:9.3f}" for v in values), end="")
            print(f"{sum(values) / len(values):9.3f}  {name}")


if __name__ == "__main__":
    main()
