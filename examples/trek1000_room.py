"""Paper D's static experiment on a recording: what weights by obstacle are worth in a room.

    python examples/trek1000_room.py FOLDER

FOLDER holds the TREK1000 room's files. Offsets are calibrated where nothing is blocked; how
each link errs behind the person is fitted on the first half of each file, and every solver
runs on the second half.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import kedge  # noqa: F401  64-bit numbers
from kedge.calibration.anchors import calibrate
from kedge.calibration.error_curves import choose_curve, fit_curve
from kedge.config.rigs import load_rig_config
from kedge.datasets.trek1000 import ANCHORS, read_trek1000
from kedge.positioning.epochs import epochs_of
from kedge.positioning.links import links
from kedge.positioning.solver import Solver, solve_all

SOLVERS = {
    "LS": Solver("ls"),
    "rows 1/s^2": Solver("wls", debias=False),
    "rows 1/(m^2+s^2)": Solver("wls-mean-square", debias=False),
    "GLS": Solver("gls", debias=False),
    "GLS debiased": Solver("gls"),
    "ML": Solver("ml"),
    "Huber": Solver("nls", loss="huber"),
    "Tukey": Solver("nls", loss="tukey"),
}
BLOCKED = {"4vba0": 0, "4vba1": 1, "4vba2s": 2, "4vba3s": 3}


def read_case(folder: Path, case: str) -> tuple[np.ndarray, np.ndarray]:
    """Ranges by epoch, and the place by Vicon."""
    log = read_trek1000(folder, case)
    table = log.tables["ranges"]
    target = np.array([ANCHORS.index(name) for name in table.texts["target"]])
    time = (table.stamps - table.stamps[0]) / 1e9
    epochs = epochs_of(time, target, table.columns["range"], len(ANCHORS), 0.0)
    whole = np.isfinite(epochs.ranges).all(axis=1)
    place = np.array([log.truth.columns[f"position_{axis}"].mean() for axis in "xy"])
    return epochs.ranges[whole], place


def anchors_of_the_rig() -> np.ndarray:
    """Where the anchors are, as the shipped rig has it."""
    columns = load_rig_config("trek1000_room").maps["anchors"].columns
    return np.stack([columns["position_x"], columns["position_y"]], axis=1)


def table_of(folder: Path) -> dict[str, dict[str, float]]:
    """RMSE in m by case and solver."""
    anchors = anchors_of_the_rig()
    ranges, place = read_case(folder, "4vnm")
    places = np.broadcast_to(place, (len(ranges), 2))
    lines = calibrate(places, anchors, ranges, with_scale=False)
    offset = np.array([line.offset for line in lines])
    print("offset of each anchor, m: ", *(f"{line.offset:.3f}" for line in lines))
    print("noise in line of sight, m:", *(f"{line.std:.3f}" for line in lines))
    found = {}
    for case, number in BLOCKED.items():
        ranges, place = read_case(folder, case)
        half = len(ranges) // 2
        error = ranges - offset - np.linalg.norm(anchors - place, axis=1)
        curves = [fit_curve(error[:half, link]) for link in range(len(anchors))]
        best = choose_curve(error[:half, number])[0]
        print(
            f"{case}: blocked link errs by {curves[number].mean:.3f} +- "
            f"{curves[number].std:.3f} m; of all families {best.family} fits best"
        )
        std, bias = ([getattr(c, key) for c in curves] for key in ("std", "mean"))
        epochs = jax.vmap(
            lambda own, s=std, b=bias: links(anchors, own, np.array(s), np.array(b))
        )(jnp.asarray(ranges[half:] - offset))
        found[case] = {}
        for name, solver in SOLVERS.items():
            gap = np.asarray(solve_all(solver, epochs).position) - place
            found[case][name] = float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    found = table_of(parser.parse_args().folder)
    print(f"\n{'RMSE, m':18s}", *(f"{case:>8s}" for case in found), f"{'mean':>8s} better by")
    means = {name: np.mean([row[name] for row in found.values()]) for name in SOLVERS}
    for name, mean in means.items():
        row = " ".join(f"{cells[name]:8.3f}" for cells in found.values())
        print(f"{name:18s} {row} {mean:8.3f} {1 - mean / means['LS']:9.0%}")


if __name__ == "__main__":
    main()
