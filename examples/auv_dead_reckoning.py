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
import dataclasses
from collections.abc import Sequence

import numpy as np

from kedge import estimate, make_filter, score
from kedge.calibration.doppler import Calibration, calibrate, typical
from kedge.config.problem import load_problem
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.estimation.log import Truth, alike
from kedge.estimation.rig import Rig
from kedge.evaluation.score import Run
from kedge.formats.readers import read_log

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


def reckoned(
    rig: str, logs: Sequence[str], found: Sequence[Calibration | None]
) -> list[tuple[Run, Truth]]:
    """Dead reckoning over runs, each with what is known of its Doppler log.

    The runs are made alike, so that one compiled program does for all of them.
    """
    problems = []
    for log, known in zip(logs, found, strict=True):
        overrides = {"output.rate": "1.0"} | ({} if known is None else known.overrides("dvl"))
        problems.append(load_problem(rig, log, until=END, overrides=overrides))
    recordings, runs = alike([problem.recording for problem in problems]), []
    for problem, recording in zip(problems, recordings, strict=True):
        assert problem.truth is not None
        # The log is built: latencies have done their work, and differ from run to run.
        sensors = tuple(dataclasses.replace(s, latency=0.0) for s in problem.rig.sensors)
        same = Rig(problem.rig.vehicle, sensors, problem.rig.prior)
        estimates = estimate(make_filter("extended"), same, recording.log)
        run = score("extended", estimates, recording, same, problem.truth)
        runs.append((run, problem.truth))
    return runs


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
    places, calibrated = list(logs.values()), "auv_akit_snapir"
    others = [[c for other, c in own.items() if other != name] or [own[name]] for name in logs]
    first = [calibration(log, options.first) for log in places]
    found = zip(
        reckoned("auv_akit_snapir-plain", places, [None] * len(places)),
        reckoned(calibrated, places, [typical(some) for some in others]),
        reckoned(calibrated, places, first),
        strict=True,
    )
    rows = []
    for (name, log), ((raw, truth), (known, _), (begun, _)) in zip(
        logs.items(), found, strict=True
    ):
        rows.append(
            (
                disagreement(log),
                100 * raw.scores.final_error_of_distance,
                100 * known.scores.final_error_of_distance,
                drift(begun, truth, options.first),
            )
        )
        print(f"{name:6s}{raw.scores.distance:7.0f}{_percents(rows[-1])}", flush=True)
    print(f"{'median':13s}{_percents(np.median(rows, axis=0))}")


def _percents(values) -> str:
    return "".join(
        f"{value:{width}.2f}%" for value, width in zip(values, (10, 7, 7, 7), strict=True)
    )


if __name__ == "__main__":
    main()
