"""Best-of times, side by side in one run, as ratios; printed and kept as JSON."""

import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import pytest


class Times:
    """Collects rows of a rival's time and ours."""

    def __init__(self):
        self.rows, self.notes = [], []

    def best(self, call, repeats, clock=time.perf_counter):
        """What the call returns, and its shortest time in s."""
        shortest = float("inf")
        for _ in range(repeats):
            before = clock()
            found = call()
            shortest = min(shortest, clock() - before)
        return found, shortest

    def row(self, what, rival, theirs, ours, at_least=None):
        """One comparison, in s an event."""
        self.rows.append(
            {
                "what": what,
                "rival": rival,
                "rival_us": theirs * 1e6,
                "kedge_us": ours * 1e6,
                "ratio": theirs / ours,
                "aim": at_least,
            }
        )

    def note(self, text):
        """A line below the table; also at once, for whoever waits (`-s`)."""
        self.notes.append(text)
        print(text, flush=True)


def interpreter(requirement):
    """Of an environment with a rival that cannot live in kedge's own.

    ``build/NAME``, made here if the network allows, or the one named by ``KEDGE_NAME``.
    """
    name = requirement.split("==")[0]
    if named := os.environ.get(f"KEDGE_{name.upper()}"):
        return named
    folder = Path("build") / name
    python = folder / "bin" / "python"
    if not (folder / "done").exists():
        # kedge's pins, which make hands on, are not the rival's.
        bare = {key: value for key, value in os.environ.items() if not key.startswith("PIP_")}
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)
            install = [python, "-m", "pip", "install", "-q", requirement]
            subprocess.run(install, check=True, env=bare)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"{requirement} cannot be installed: {error}")
        (folder / "done").touch()
    return str(python)


COLLECTED = Times()


@pytest.fixture(scope="session")
def times():
    return COLLECTED


def pytest_terminal_summary(terminalreporter):
    if not (COLLECTED.rows or COLLECTED.notes):
        return
    write = terminalreporter.write_line
    wide, rival = (
        max([least, *(len(row[key]) for row in COLLECTED.rows)])
        for key, least in (("what", 28), ("rival", 10))
    )
    write(
        f"{'':{wide}s} {'rival':>{rival}s} {'us/event':>10s} {'kedge':>10s} {'ratio':>8s} "
        f"{'aim':>6s}"
    )
    for row in COLLECTED.rows:
        write(
            f"{row['what']:{wide}s} {row['rival']:>{rival}s} {row['rival_us']:10.2f} "
            f"{row['kedge_us']:10.3f} {row['ratio']:7.1f}x {row['aim'] or 0:5g}x"
        )
    for note in COLLECTED.notes:
        write(note)
    machine = {"machine": platform.machine(), "cores": os.cpu_count()}
    target = Path(os.environ.get("BENCH", "build/benchmarks.json"))
    target.parent.mkdir(parents=True, exist_ok=True)
    content = {**machine, "rows": COLLECTED.rows, "notes": COLLECTED.notes}
    target.write_text(json.dumps(content, indent=2) + "\n")
