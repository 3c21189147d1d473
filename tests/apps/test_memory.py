"""The memory that a study needs does not grow with the number of its runs."""

import csv
import os
import subprocess
import sys

import pytest

from fixtures.studies import buoy_text

SCENARIO = buoy_text(duration=10.0, burn_in=0.0, runs=1, filters=["kalman", "ensemble:count=8"])
PEAK = """
import resource, sys
from kedge.apps import cli
try:
    cli.main()
except SystemExit as end:
    assert not end.code, end.code
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
ALLOWED = 40 * 1024  # KiB: few floats by run, some of them twice, and what an allocator keeps


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="peak memory is told in KiB on Linux")
def test_peak_memory_is_flat_from_200_to_20000_runs(tmp_path):
    (tmp_path / "buoy.toml").write_text(SCENARIO)
    peaks, users = {}, {**os.environ, "KEDGE_ENGINE": ""}
    # As users run it: one filter by machine code, one by XLA. The first run compiles, which
    # takes more memory than anything after it.
    for name, runs in (("first", 32), ("few", 200), ("many", 20_000)):
        done = subprocess.run(
            [sys.executable, "-c", PEAK, "study", str(tmp_path / "buoy.toml"),
             "--runs", str(runs), "--chunk", "100", "--out", str(tmp_path / name)],
            capture_output=True, text=True, check=False, env=users,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        peaks[name] = int(done.stdout.splitlines()[-1])
        print(f"{runs} runs: {peaks[name] / 1024:.0f} MiB")
    assert abs(peaks["many"] - peaks["few"]) < ALLOWED, peaks
    with (tmp_path / "many" / "runs.csv").open() as file:
        assert sum(1 for _ in csv.reader(file)) == 1 + 2 * 20_000
