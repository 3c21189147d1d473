"""Dead reckoning of a sea-going AUV over seven runs: as it comes, and calibrated on other runs.

    python examples/auv_dead_reckoning.py FOLDER [--runs 1,2,3] [--first SECONDS]

FOLDER holds DVL_trajectoryN.csv and GT_trajectoryN.csv. Prints for each run, in % of the
distance covered, how far the reference's own velocity misses its position, and the error at the
end of dead reckoning from the Doppler log with the reference's attitude:

* raw: as it is stamped, scale 1, no misalignment, no arm;
* others: scale, misalignment, arm and clock from all other runs (their medians);
* first: these from the run's own first seconds; of the distance after them.
"""

import argparse

import numpy as np

from kedge import estimate, make_filter, score
from kedge.apps.workflow import use_compilation_cache
from kedge.estimation.log import Truth
from kedge.evaluation.doppler_calibration import Calibration, calibrate, typical
from kedge.evaluation.score import Run
from kedge.files.problem import load_problem
from kedge.files.readers import read_log

END = 400.0  # s; the readings that come after the reference ends have nothing to be judged by


def calibration(log: str, until: float = np.inf) -> Calibration:
    """What the first seconds of a run say of its Doppler log."""
    raw = read_log(log, "auv_akit_snapir")
    dvl, table = raw.tables["dvl"], raw.tables["reference"]
    chosen = table.stamps / 1e9 <= until

    def field(name: str, axes: str) -> np.ndarray:
        return np.stack([table.columns[f"{name}_{axis}"][chosen] for axis in axes], axis=1)

    fields = {
        "attitude": field("attitude", "wxyz"),
        "velocity_body": field("velocity_body", "xyz"),
    }
    velocity = np.stack([dvl.columns[f"velocity_body_{axis}"] for axis in "xyz"], axis=1)
    return calibrate(dvl.stamps / 1e9, velocity, Truth(table.stamps[chosen] / 1e9, fields))


def reckoned(rig: str, log: str, found: Calibration | None = None) -> tuple[Run, Truth]:
    """Dead reckoning over a run."""
    overrides = {"output.rate": "1.0"} | ({} if found is None else found.overrides("dvl"))
    problem = load_problem(rig, log, until=END, overrides=overrides)
    assert problem.truth is not None
    estimates = estimate(make_filter("extended"), problem.rig, problem.recording.log)
    run = score("extended", estimates, problem.recording, problem.rig, problem.truth)
    return run, problem.truth


def drift(run: Run, truth: Truth, since: float) -> float:
    """Growth of the position error since then, in % of the distance covered since then."""
    assert run.errors is not None
    error = run.errors.error[:, run.errors.fields["position"]]
    late = np.flatnonzero((run.errors.time >= since) & np.isfinite(error).all(axis=1))
    path = truth.fields["position"][truth.time >= since]
    distance = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    return float(100 * np.linalg.norm(error[late[-1]] - error[late[0]]) / distance)


def disagreement(log: str) -> float:
    """How far the reference's velocity, integrated, misses its own position, in %."""
    note = read_log(log, "auv_akit_snapir").notes[0]
    return float(note.split(" m, ")[1].split(" %")[0])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder")
    parser.add_argument("--runs", default="1,2,3,4,5,6,7")
    parser.add_argument("--first", type=float, default=150.0)
    options = parser.parse_args()
    use_compilation_cache()
    logs = {name: f"{options.folder}#{name}" for name in options.runs.split(",")}
    own = {name: calibration(log) for name, log in logs.items()}
    print("run   scale  misalignment (mrad)    arm (m)              lag (s)  left (m/s)")
    for name, found in own.items():
        turned = " ".join(f"{1e3 * x:6.2f}" for x in found.misalignment)
        arm = " ".join(f"{x:6.2f}" for x in found.arm)
        print(
            f"{name:4s} {found.scale:.4f}  {turned}  {arm}  {found.lag:6.3f}  {found.std:.4f}"
        )
    print(f"\n{'run':6s}{'m':>7s}{'reference':>11s}{'raw':>8s}{'others':>8s}{'first':>8s}")
    rows = []
    for name, log in logs.items():
        raw, truth = reckoned("auv_akit_snapir-plain", log)
        others = [found for other, found in own.items() if other != name]
        calibrated, _ = reckoned("auv_akit_snapir", log, typical(others or [own[name]]))
        begun, _ = reckoned("auv_akit_snapir", log, calibration(log, options.first))
        rows.append(
            (
                disagreement(log),
                100 * raw.scores["final_error_of_distance"],
                100 * calibrated.scores["final_error_of_distance"],
                drift(begun, truth, options.first),
            )
        )
        print(f"{name:6s}{raw.scores['distance']:7.0f}{_percents(rows[-1])}", flush=True)
    print(f"{'median':13s}{_percents(np.median(rows, axis=0))}")


def _percents(values) -> str:
    return "".join(
        f"{value:{width}.2f}%" for value, width in zip(values, (10, 7, 7, 7), strict=True)
    )


if __name__ == "__main__":
    main()
