"""A small part of ``make fuzz``: every reader refuses or reads what is damaged."""

import random
import subprocess
import sys
from pathlib import Path

from fuzz.mutation import mutated_bytes, mutated_text

FUZZ = Path(__file__).with_name("fuzz.py")


def run(*arguments):
    command = [sys.executable, FUZZ, "--workers", "1", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_reader_refuses_or_reads():
    light = "bag: json", "plaza (packed)", "log folder", "tum", "filter", "--set", "mrclam"
    done = run("--inputs", "300", *(f"--only={name}" for name in light))
    rows = {line[:20].strip(): line[20:].split() for line in done.stdout.splitlines()}
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(rows) == {*light, "reader", "all"}
    inputs, accepted, refused, neither, *_ = map(float, rows["all"])
    assert 295 <= inputs <= 305
    assert accepted + refused == inputs
    assert min(accepted, refused) > 20
    assert neither == 0


def test_a_process_that_dies_or_hangs_or_raises_is_a_fault(tmp_path):
    """The runner itself, over targets of its own."""
    (tmp_path / "targets.py").write_text(
        "import os, time\n"
        "class Targets:\n"
        "    by_name = {'dies': (1.0, lambda draw: os._exit(1)),\n"
        "        'hangs': (1.0, lambda draw: time.sleep(60)),\n"
        "        'raises': (1.0, lambda draw: {}['key']), 'reads': (1.0, lambda draw: None)}\n"
        "    def close(self): pass\n"
    )
    for name in ("fuzz.py", "mutation.py"):
        (tmp_path / name).write_text(FUZZ.with_name(name).read_text())
    command = [sys.executable, tmp_path / "fuzz.py", "--inputs", "4", "--limit", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "--only 'dies' --number 0: the process died" in done.stdout
    assert "--only 'hangs' --number 0: took over 1 s" in done.stdout
    assert "--only 'raises' --number 0: KeyError: 'key'" in done.stdout
    assert "'reads' --number" not in done.stdout


def test_the_same_seed_does_the_same_damage():
    def damage(seed):
        draw = random.Random(seed)
        return mutated_bytes(bytes(range(200)), draw), mutated_text("rate = 5\n[a]\n", draw)

    assert damage("2026 tum 7") == damage("2026 tum 7")
    assert len({damage(f"2026 tum {number}") for number in range(50)}) > 45
