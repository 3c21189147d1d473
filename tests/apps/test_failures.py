"""Whatever goes wrong is one line and an exit code that says whose fault it is."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kedge.apps import catalogue

FULL = Path("/dev/full")


def fails(error):
    def failing(*arguments, **options):
        raise error

    return failing


@pytest.mark.parametrize(
    ("error", "code", "parts"),
    [
        (ValueError("no such\nthing"), 70, ["a defect of kedge: ValueError: no such (cli.py:"]),
        (ValueError("x" * 5000), 70, ["xxx... (cli.py:", "--debug shows"]),
        (MemoryError("8 TiB"), 2, ["not enough memory: MemoryError: 8 TiB", "--debug"]),
        (RuntimeError("RESOURCE_EXHAUSTED: 9 TB"), 2, ["not enough memory", "9 TB"]),
        (PermissionError(13, "Permission denied", "/x"), 2, ["/x: Permission denied"]),
    ],
    ids=["defect", "long", "memory", "device memory", "operating system"],
)
def test_what_is_no_error_of_kedge_becomes_one_line(monkeypatch, kedge, error, code, parts):
    monkeypatch.setattr(catalogue, "catalogue", fails(error))
    status, out, err = kedge("list")
    assert (status, out, err.count("\n")) == (code, "", 1)
    assert len(err) < 500
    for part in parts:
        assert part in err


def test_debug_shows_the_traceback_wherever_it_stands(monkeypatch, kedge):
    monkeypatch.setattr(catalogue, "catalogue", fails(ValueError("deep")))
    for arguments in (["--debug", "list"], ["list", "--debug"]):
        code, _, err = kedge(*arguments)
        assert code == 70
        assert "Traceback (most recent call last)" in err
        assert "in failing" in err
        assert err.splitlines()[-1].startswith("kedge: a defect of kedge: ValueError: deep")


def run(*arguments, **options):
    command = [sys.executable, "-m", "kedge.apps.cli", *arguments]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, **options)


@pytest.mark.skipif(not FULL.exists(), reason="the system has no file that is always full")
def test_standard_output_that_is_full():
    with FULL.open("w") as full:
        done = run("--version", stdout=full)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("kedge: standard output")
    assert "No space left on device" in done.stderr


@pytest.mark.skipif(os.name != "posix", reason="closes a file descriptor")
def test_standard_output_that_is_closed():
    done = subprocess.run(
        ["sh", "-c", f"'{sys.executable}' -m kedge.apps.cli --version >&-"],
        stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "kedge: standard output: cannot be written: Bad file descriptor\n"


@pytest.mark.skipif(os.name != "posix", reason="a pipe of a shell")
def test_a_reader_that_has_seen_enough_is_no_failure_to_speak_of():
    # All that there is: more than a pipe holds once its reader is gone.
    command = f"{{ '{sys.executable}' -m kedge.apps.cli list; echo $? >&2; }} | head -1"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "vehicles"
    assert done.stderr.strip() == "0"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("study", "lorenz63", "--seed", "1e20"), "Invalid value for '--seed'"),
        (("study", "lorenz63", "--outt", "x"), "No such option: --outt"),
        (("studdy",), "No such command 'studdy'"),
        (("estimate",), "Missing argument 'rig'"),
    ],
)
def test_a_mistyped_command_line_is_answered_in_one_line(arguments, message):
    done = run(*arguments)
    assert done.returncode == 2
    assert done.stderr.startswith(f"kedge: {message}")
    assert done.stderr.count("\n") == 1


def test_a_platform_that_is_not_there_is_not_blamed_on_the_rig(site):
    done = run(
        "estimate", str(site / "rig.toml"), str(site / "log"), "--out", str(site / "out"),
        env=os.environ | {"JAX_PLATFORMS": "nonsense"},
    )  # fmt: skip
    assert done.returncode == 2
    message = [text for text in done.stderr.splitlines() if not text.startswith("[")]
    assert len(message) == 1, done.stderr
    assert message[0].startswith("kedge: JAX_PLATFORMS=nonsense: JAX cannot compute")


@pytest.mark.skipif(os.name != "posix", reason="locales and homes of POSIX")
def test_a_plain_locale_and_a_home_that_cannot_be_written_are_no_obstacle(site):
    """As in a container: no UTF-8, no home folder, no cache; the result is what it is else."""
    homeless = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    places = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")
    homeless |= dict.fromkeys(places, "/dev/null/none")
    folder = site / "ergebnis-ä"
    done = run(
        "estimate", str(site / "rig.toml"), str(site / "log"), "--out", str(folder),
        env={k: v for k, v in os.environ.items() if k != "KEDGE_NATIVE_CACHE"} | homeless,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (folder / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["filters"]
    assert summary["arguments"][-1] == str(folder)
