"""Kill commands at random moments: nothing that was whole is lost, and the next run succeeds.

``python tests/fuzz/kills.py --count 50 --seed 1`` prints a row for each command. Commands
run in copies of a process that has all imported, so that most of the time is theirs.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import kedge.apps.study
import kedge.apps.tune
import kedge.apps.workflow  # noqa: F401  what commands import when they run, once for all
from kedge.apps import cli
from kedge.formats.results_folder import check_unchanged, read_mark, reserved_folder

SCENARIO = """
[scenario]
title = "a buoy"
source = "these tests"
duration = 3.0
dt = 0.5
burn_in = 1.0
runs = 12
chunk = 2
filters = ["kalman"]
[vehicle]
model = "constant-velocity"
[sensors.gnss]
model = "gnss"
[prior]
std = { position = 1.0, velocity = 0.3 }
"""


class Command(NamedTuple):
    """What is killed."""

    name: str
    first: list[str]
    """Makes what is there before; none: nothing is."""
    killed: list[str]
    again: list[str]
    """What a user does next; ``--resume`` is added where there is something to go on with."""
    resumes: bool = False


class Trial(NamedTuple):
    """What became of one kill."""

    command: str
    ended: bool
    """The command was done before it was killed."""
    kept: str
    """What is there at the next run's begin: old, new, or part of a new one."""
    complaints: list[str]
    seconds: float
    """How long the command ran."""


def commands(place: Path) -> list[Command]:
    """The commands, on a log and a scenario that are there."""
    rig, log, out = "yard", str(place / "log"), ["--out", str(place / "out")]
    quick = ["--no-report", *out]
    first = ["estimate", rig, log, *quick, "--seed", "1", "--filter", "dead-reckoning"]
    estimate = ["estimate", rig, log, *out]
    study = ["study", str(place / "buoy.toml"), *quick]
    merge = ["merge", str(place / "a"), str(place / "b"), *quick]
    tune = ["tune", rig, log, *quick, "--starts", "1", "--parameters"]
    forced = [*study, "--force", "--seed", "3"]
    return [
        Command("estimate", first, estimate, estimate),
        Command("study", [], study, study, True),
        Command("study --force", study, forced, forced),
        Command("merge", [], merge, merge, True),
        Command("tune", [*tune, "range_std"], [*tune, "bearing_std"], [*tune, "bearing_std"]),
    ]


def prepare(place: Path) -> None:
    """A log, a scenario and its shards."""
    (place / "buoy.toml").write_text(SCENARIO)

    def log() -> None:
        import jax.numpy as jnp
        import jax.random as jr

        from kedge.core.beliefs import Gaussian
        from kedge.core.registry import make_sensor, make_vehicle
        from kedge.estimation.rig import Installation, Rig
        from kedge.formats.logs import write_log
        from kedge.formats.simulated import simulated_log
        from kedge.simulation.scenario import Scenario

        vehicle = make_vehicle("unicycle", speed_noise=0.3, yaw_rate_noise=0.03)
        camera = Installation("camera", make_sensor("landmarks"), rate=2.0)
        rig = Rig(vehicle, (camera,), Gaussian(vehicle.start(), 1e-4 * jnp.eye(3)))
        write_log(place / "log", simulated_log(Scenario(rig, 20.0), jr.key(0), "a yard"))

    code, _ = forked(log)
    assert code == 0
    for shard, name in (("1/2", "a"), ("2/2", "b")):
        study = ["study", str(place / "buoy.toml"), "--out", str(place / name)]
        assert run([*study, "--shard", shard, "--no-report"])[0] == 0


def forked(work: Callable[[], None], kill_after: float | None = None) -> tuple[int, float]:
    """Exit code of a copy of this process that does some work, and how long it took."""
    begin, child = time.monotonic(), os.fork()
    if child == 0:
        code = 1
        try:
            with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
                work()
            code = 0
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        finally:
            os._exit(code)
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        seconds = time.monotonic() - begin
        if done:
            return os.waitstatus_to_exitcode(status), seconds
        if kill_after is not None and seconds > kill_after:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)


def run(arguments: list[str], kill_after: float | None = None) -> tuple[int, float]:
    """Run a command; what it says on standard error goes into the log ``kills.err``."""

    def work() -> None:
        sys.argv = ["kedge", *arguments]
        os.dup2(os.open("kills.err", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
        cli.main()

    return forked(work, kill_after)


def result(out: Path) -> str:
    """What a folder holds, as figures that pin it, and whether every file is as written."""
    mark = read_mark(out)
    if mark is None:
        return ""
    for name in mark.files:
        assert (out / name).is_file(), name
        check_unchanged(out, mark, name)
    for name, key in (("summary.json", "digest"), ("tune.json", "parameters")):
        if name in mark.files:
            return json.dumps(json.loads((out / name).read_text())[key])
    return "part"


def trial(command: Command, place: Path, delay: float, foreign: bool, new: str) -> Trial:
    """Make what is there before, kill, look, and run again."""
    out, notes, complaints = place / "out", place / "out" / "notes.txt", []
    shutil.rmtree(out, ignore_errors=True)
    old = ""
    if command.first:
        if run(command.first)[0] != 0:
            complaints.append("what comes before failed")
        old = result(out)
        if foreign:
            notes.write_text("mine")
    foreign = notes.is_file()
    code, seconds = run(command.killed, delay)
    chunks = {path.name for path in out.glob("chunks/*.npz")}
    if foreign and not notes.is_file():
        complaints.append("notes are gone")
    with reserved_folder(out):  # as the next run begins
        kept = result(out) if out.is_dir() else ""
    if old and kept not in (old, new):
        complaints.append(f"neither old nor new: {kept[:40]}")
    if not chunks <= {path.name for path in out.glob("chunks/*.npz")}:
        complaints.append("chunks are gone")
    goes_on = command.resumes and (out / "study.json").is_file()
    if run([*command.again, *(["--resume"] if goes_on else [])])[0] != 0:
        complaints.append("the next run failed")
    elif result(out) != new:
        complaints.append("the next run gave something else")
    if foreign and notes.read_text() != "mine":
        complaints.append("notes are gone")
    if drafts := [p.name for p in (*place.glob(".kedge-*"), *out.glob("**/.kedge-*"))]:
        complaints.append(f"left over: {drafts}")
    state = "new" if kept == new else "old" if kept == old else "part"
    return Trial(command.name, code == 0, state if kept else "none", complaints, seconds)


def trials(count: int, seed: int, place: Path) -> Iterator[Trial]:
    """Kills of each command in turn, half of them while it writes."""
    draw = random.Random(seed)
    prepare(place)
    taken: dict[str, tuple[float, str]] = {}
    for number in range(count):
        command = commands(place)[number % 5]
        if command.name not in taken:
            shutil.rmtree(place / "out", ignore_errors=True)
            run([a for a in command.killed if a != "--force"])  # compiles
            shutil.rmtree(place / "out", ignore_errors=True)
            code, seconds = run([a for a in command.killed if a != "--force"])
            assert code == 0, command
            taken[command.name] = seconds, result(place / "out")
        seconds, new = taken[command.name]
        begin = draw.choice([0.0, 0.7])
        delay = seconds * draw.uniform(begin, 1.02)
        one = trial(command, place, delay, draw.random() < 0.4, new)
        if one.ended:  # a machine that was busy is so no more
            taken[command.name] = min(seconds, 0.9 * one.seconds), new
        yield one


def main() -> int:
    """Print a row for each command; 1 if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        done = []
        for one in trials(arguments.count, arguments.seed, Path(folder)):
            done.append(one)
            text = "; ".join(one.complaints) or one.kept
            print(f"{len(done)}. {one.command}: {text}", file=sys.stderr, flush=True)
    states = ("none", "old", "part", "new")
    print(f"{'command':14} kills in_time {' '.join(f'{s:>5}' for s in states)} complaints")
    for name in dict.fromkeys(one.command for one in done):
        rows = [one for one in done if one.command == name]
        found = " ".join(f"{sum(r.kept == s for r in rows):5}" for s in states)
        in_time = sum(not r.ended for r in rows)
        complaints = sum(bool(r.complaints) for r in rows)
        print(f"{name:14} {len(rows):5} {in_time:7} {found} {complaints:10}")
    return int(any(one.complaints for one in done))


if __name__ == "__main__":
    sys.exit(main())
