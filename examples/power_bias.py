"""What the received power says of a range's error: learned at rest, used on the move.

    python examples/power_bias.py FOLDER

FOLDER is that of the Hanyang University data set. The curve of bias over received power is
fitted to the static measurements, half of them by distance; it is judged on the other half,
and on the four runs of a walker, whose truth it has never seen. The walker's filter is the
shipped rig, with the ranges as they are and with the curve taken off.
"""

import argparse
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from hanyang_errors import read_static

from kedge import Problem, load_problem, run_filters, use_compilation_cache
from kedge.calibration.power_bias import PowerBias, fit_power_bias
from kedge.formats.cells import read_cells

RUNS = [f"{sight}/Trajectory_A/Case_{case}" for sight in ("LOS", "NLOS") for case in (1, 2)]
KNOTS = 10


def table_of(archive: Path) -> np.ndarray:
    """One row a range: horizontal distance (m), error (m), received power (dBm)."""
    rows = [(row.horizontal, row.error, row.power) for row in read_static(archive)]
    table = np.array(rows)
    return table[np.isfinite(table[:, 2])]


def spread(error: np.ndarray) -> float:
    """1.4826 times the median distance from the median, which gross errors do not change."""
    return float(1.4826 * np.median(np.abs(error - np.median(error))))


def without_bias(problem: Problem, folder: Path, curve: PowerBias) -> Problem:
    """The problem with each range less the bias of the power that it was received with."""
    source, log = problem.sources["radio"], problem.recording.log
    powers = {}
    for file in folder.glob("A*.csv*"):
        cells = read_cells(file)
        stamps, anchor = cells.stamps("field.stamp", "ns"), cells.text("field.id")
        for key in zip(
            stamps, anchor, cells.numbers("field.rssi", not_finite="reject"), strict=True
        ):
            powers[int(key[0]), key[1]] = key[2]
    keys = zip(source.stamps, source.targets or [], strict=True)
    power = np.array([powers[int(stamp), target] for stamp, target in keys])
    (readings,) = log.readings
    bias, _ = curve.at(np.where(np.isfinite(power), power, np.nan))
    measurement = type(readings.measurement)(jnp.asarray(readings.measurement.range) - bias)
    log = log._replace(readings=(readings._replace(measurement=measurement),))
    return problem._replace(recording=problem.recording._replace(log=log))


def score(problem: Problem) -> str:
    """RMSE of the position, and the share of errors inside the 95 % bound."""
    (run,) = run_filters(problem, [problem.filter], 0, lambda text: None)
    return f"{run.scores.rmse['position']:8.3f}{run.scores.coverage_95['position']:8.2f}"


def main() -> None:
    """Fit, judge, use."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    root = parser.parse_args().folder
    use_compilation_cache()
    table = table_of(root / "Static_measurements.tar.gz")
    known = np.round(table[:, 0]).astype(int) % 4 == 0  # they go up by 2 m
    curve = fit_power_bias(table[known, 2], table[known, 1], KNOTS)
    print("power, dBm:", *(f"{power:8.1f}" for power in curve.power))
    print("bias, m:   ", *(f"{bias:8.3f}" for bias in curve.bias))
    bias, _ = curve.at(table[~known, 2])
    error = table[~known, 1]
    print(
        f"at rest, other distances: {len(error)} ranges, median {np.median(error):.3f} m, "
        f"spread {spread(error):.3f} m; less the curve {np.median(error - bias):.3f} m, "
        f"{spread(error - np.asarray(bias)):.3f} m"
    )
    print(f"{'walker':24s}{'RMSE m':>8s}{'in 95 %':>8s}{'less the curve':>18s}")
    for part in RUNS:
        problem = load_problem("hanyang_uwb", f"{root / 'Dynamic_measurements'}#{part}")
        better = without_bias(problem, root / "Dynamic_measurements" / part, curve)
        print(f"{part:24s}{score(problem)}  {score(better)}")


if __name__ == "__main__":
    main()
