"""How long a user waits for ``kedge --help``: the whole process, best of several."""

import subprocess
import sys


def test_help(times):
    command = [sys.executable, "-m", "kedge.apps.cli", "--help"]
    _, seconds = times.best(lambda: subprocess.run(command, capture_output=True, check=True), 7)
    times.note(f"kedge --help: {seconds:.2f} s (aim: under 0.7 s)")
