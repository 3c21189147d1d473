"""A few kills at random moments; ``kills.py --count 50`` is the whole of it."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_nothing_that_was_whole_is_lost():
    # A process of its own: copies of one in which JAX computes would wait for its threads.
    script = Path(__file__).with_name("kills.py")
    command = [sys.executable, "-W", "ignore", script, "--count", "5", "--seed", "3"]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    rows = [line.split() for line in run.stdout.splitlines()[1:]]
    assert sum(int(row[-6]) for row in rows) >= 2, run.stdout  # killed before they ended
