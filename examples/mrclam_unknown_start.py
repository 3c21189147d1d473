"""MRCLAM dataset 7 with an unknown start: how long until the pose is found, by which filter.

    python examples/mrclam_unknown_start.py [FOLDER] [--until 120] [--robots 1,2,3,4,5]

Found is the first time from which, for ten seconds, the error stays below 0.5 m and 20 degrees.
"""

import argparse
import math

import numpy as np

from kedge import load_problem, run_filters, use_compilation_cache
from kedge.datasets.fetch import require_located
from kedge.evaluation.score import Errors

NAMES = ("particle:count=1000", "particle:count=5000", "extended", "unscented")


def found_after(errors: Errors, hold: float = 10.0) -> float:
    """Time in s until the pose is found; infinity if it is not."""
    position = np.linalg.norm(errors.error[:, errors.fields["position"]], axis=1)
    heading = np.abs(errors.error[:, errors.fields["heading"]][:, 0])
    good = (position < 0.5) & (heading < math.radians(20))
    for index in np.flatnonzero(good):
        held = errors.time <= errors.time[index] + hold
        if good[index:][held[index:]].all():
            return float(errors.time[index])
    return math.inf


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?")
    parser.add_argument("--until", type=float, default=120.0)
    parser.add_argument("--robots", default="1,2,3,4,5")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    use_compilation_cache()
    folder = options.folder or str(require_located("mrclam"))
    print(f"{'robot':>5s} {'first reading':>14s}" + "".join(f"{name:>22s}" for name in NAMES))
    for robot in options.robots.split(","):
        problem = load_problem("mrclam-lost", f"{folder}#{robot}", until=options.until)
        first = np.asarray(problem.recording.log.schedule.time)[
            np.flatnonzero(np.asarray(problem.recording.log.schedule.sensor) >= 0)[0]
        ]
        runs = run_filters(problem, NAMES, options.seed, say=lambda text: None)
        times = [found_after(run.errors) if run.errors else math.inf for run in runs]
        cells = (f"{t:20.1f} s" if math.isfinite(t) else f"{'never':>22s}" for t in times)
        print(f"{robot:>5s} {first:12.1f} s" + "".join(cells), flush=True)


if __name__ == "__main__":
    main()
