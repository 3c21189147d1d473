"""Damaged input to every reader, in processes that may die: ``make fuzz``.

Each input follows from the seed and its number alone: ``--only NAME --number N`` does one
again, with its traceback. What is no refusal (a ``KedgeError``) and no acceptance is a fault:
any other exception, a process that dies, one that takes longer than ``--limit``.
"""

import argparse
import contextlib
import multiprocessing
import random
import sys
import time
import traceback
import warnings
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent))
SEED = 2026
LINUX = sys.platform == "linux"


class Outcome(NamedTuple):
    """What became of one input."""

    target: str
    number: int
    kind: str
    seconds: float = 0.0
    megabytes: float = 0.0
    """By which the memory grew while it was read."""
    fault: str = ""


def work(pipe, names: list[str] | None) -> None:
    """Answer each number with its outcome, until there is none left."""
    warnings.simplefilter("ignore")
    from targets import Targets

    from kedge.core.errors import KedgeError

    targets = Targets()
    pipe.send({name: weight for name, (weight, _) in targets.by_name.items()})
    with contextlib.suppress(EOFError):
        while (job := pipe.recv()) is not None:
            name, number = job
            kind, fault, before, begin = "accepted", "", _memory(True), time.perf_counter()
            try:
                targets.by_name[name][1](random.Random(f"{SEED} {name} {number}"))
            except KedgeError as error:
                kind = "refused"
                if not str(error).strip():
                    kind, fault = "neither", "an error without a message"
            except BaseException as error:
                frames = traceback.extract_tb(error.__traceback__)
                last = next((f for f in reversed(frames) if "kedge" in f.filename), frames[-1])
                what = f"{type(error).__name__}: {error}"[:100]
                kind, fault = "neither", f"{what} ({Path(last.filename).name}:{last.lineno})"
                if names:
                    traceback.print_exc()
            seconds = time.perf_counter() - begin
            pipe.send(Outcome(name, number, kind, seconds, _memory() - before, fault))
    targets.close()


def _memory(reset: bool = False) -> float:
    """MB that were resident at most since the last ``reset``; 0 where nobody says so."""
    if not LINUX:
        return 0.0
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    return float(status.partition("VmHWM:")[2].split()[0]) / 1024


class Worker:
    """A process that reads, and another if it dies."""

    def __init__(self, names: list[str] | None, limit: float):
        self.names, self.limit = names, limit
        self.begin()

    def begin(self) -> None:
        """A process anew."""
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(theirs, self.names), daemon=True)
        self.process.start()
        theirs.close()
        self.weights = self.pipe.recv()
        self.job, self.since = None, 0.0

    def give(self, job: tuple[str, int] | None) -> None:
        """The next input; None ends."""
        self.job, self.since = job, time.perf_counter()
        self.pipe.send(job)

    def outcome(self) -> Outcome | None:
        """What became of the input; None as long as it is read."""
        assert self.job is not None
        seconds = time.perf_counter() - self.since
        try:
            if self.pipe.poll():
                return self.pipe.recv()
            dead = not self.process.is_alive()
        except (EOFError, ConnectionResetError):
            dead = True
        if dead or seconds > self.limit:
            job, fault = self.job, "the process died" if dead else f"took over {self.limit:g} s"
            self.process.kill()
            self.begin()
            return Outcome(*job, "neither", seconds, 0.0, fault)
        return None


def run(
    inputs: int, workers: int, limit: float, names: list[str] | None, first: int = 0
) -> list[Outcome]:
    """Share the inputs among the workers; each reader's are numbered from ``first``."""
    crew = [Worker(names, limit) for _ in range(workers)]
    weights = {n: w for n, w in crew[0].weights.items() if not names or n in names}
    total = sum(weights.values())
    counts = {n: round(inputs * w / total) or 1 for n, w in weights.items()}
    jobs = [(n, first + k) for n, count in counts.items() for k in range(count)]
    random.Random(SEED).shuffle(jobs)
    outcomes, idle = [], list(crew)
    while jobs or len(idle) < len(crew):
        while idle and jobs:
            idle.pop().give(jobs.pop())
        busy = [worker for worker in crew if worker not in idle]
        multiprocessing.connection.wait([worker.pipe for worker in busy], timeout=1.0)
        for worker in busy:
            if (outcome := worker.outcome()) is not None:
                outcomes.append(outcome)
                idle.append(worker)
    for worker in crew:
        worker.give(None)
    for worker in crew:
        worker.process.join(10)
    return outcomes


def table(outcomes: list[Outcome]) -> str:
    """A row by reader; then each kind of fault once, with an input that shows it."""
    by_target = defaultdict(list)
    for outcome in outcomes:
        by_target[outcome.target].append(outcome)
    head = ("reader", "inputs", "accepted", "refused", "neither", "slowest s", "memory MB")
    rows = [head]
    for name, group in [*sorted(by_target.items()), ("all", outcomes)]:
        kinds = [sum(o.kind == kind for o in group) for kind in head[2:5]]
        most = [max(o.seconds for o in group), max(o.megabytes for o in group)]
        rows.append((name, len(group), *kinds, f"{most[0]:.2f}", f"{most[1]:.0f}"))
    lines = [f"{row[0]!s:20}" + "".join(f"{cell!s:>11}" for cell in row[1:]) for row in rows]
    faults = defaultdict(list)
    for outcome in outcomes:
        if outcome.fault:
            faults[outcome.target, outcome.fault.rpartition("(")[2]].append(outcome)
    for group in faults.values():
        first = group[0]
        lines.append(
            f"{len(group)} x --only {first.target!r} --number {first.number}: {first.fault}"
        )
    return "\n".join(lines)


def main() -> int:
    """Read, print the table; 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument(
        "--first", type=int, default=0, help="number of each reader's first input"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for one input")
    parser.add_argument("--only", action="append", help="a reader of the table")
    parser.add_argument("--number", type=int, help="one input alone, with its traceback")
    chosen = parser.parse_args()
    if chosen.number is not None:
        ours, theirs = multiprocessing.Pipe()
        ours.send((chosen.only[0], chosen.number))
        ours.send(None)
        work(theirs, chosen.only)
        ours.recv()
        outcomes = [ours.recv()]
    else:
        outcomes = run(chosen.inputs, chosen.workers, chosen.limit, chosen.only, chosen.first)
    print(table(outcomes))
    return int(any(outcome.kind == "neither" for outcome in outcomes))


if __name__ == "__main__":
    import multiprocessing.connection

    sys.exit(main())
