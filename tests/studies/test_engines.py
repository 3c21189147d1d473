"""Interruption, shards and engines: what is done is kept, and no number changes."""

import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from fixtures.studies import buoy_text
from kedge.apps import study
from kedge.studies import engines
from kedge.studies.chunks import open_study

SCENARIO = buoy_text(runs=8)


@pytest.fixture
def buoy(tmp_path):
    path = tmp_path / "buoy.toml"
    path.write_text(SCENARIO)
    return path


def digest(folder):
    return json.loads((folder / "summary.json").read_text())["digest"]["all"]


def interrupted_after(count, engine):
    """An engine that Ctrl-C ends."""

    def run(job, numbers, progress):
        for done, chunk in enumerate(engine(job, numbers, progress)):
            if done == count:
                raise KeyboardInterrupt
            yield chunk

    return run


def test_what_is_done_is_kept_and_gone_on_with(buoy, kedge, tmp_path, monkeypatch):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    chunks = ("--chunk", "3", "--no-report")
    code, _, err = kedge("study", buoy, "--out", whole, *chunks)
    assert code == 0, err

    with monkeypatch.context() as patch:
        patch.setattr(study, "chosen", lambda *_: interrupted_after(2, engines.local))
        code, out, err = kedge("study", buoy, "--out", cut, *chunks)
    assert (code, out) == (130, "")
    said = f"interrupted; 2 of 3 chunks are kept in {cut}; --resume goes on"
    assert said in err.splitlines()[-1]
    assert not (cut / "summary.json").exists()

    code, _, err = kedge("study", buoy, "--out", cut, *chunks)
    assert code == 2
    assert "holds a study already; --resume goes on with it, --force replaces it" in err
    code, _, err = kedge("study", buoy, "--out", cut, "--seed", "1", "--resume", *chunks)
    assert code == 2
    assert "holds another study (other: seed)" in err
    code, _, err = kedge("study", buoy, "--out", cut, "--resume", *chunks)
    assert code == 0, err
    assert "2 of 3 chunks are there already" in err
    assert digest(cut) == digest(whole)

    code, _, err = kedge("study", buoy, "--out", cut, "--runs", "2", "--force", "--no-report")
    assert code == 0, err
    assert digest(cut) != digest(whole)
    assert len(list((cut / "chunks").iterdir())) == 1


def test_shards_are_merged(buoy, kedge, tmp_path):
    whole, *parts = (tmp_path / name for name in ("whole", "first", "second"))
    chunks = ("--chunk", "3", "--no-report")
    assert kedge("study", buoy, "--out", whole, *chunks)[0] == 0
    code, out, err = kedge("study", buoy, "--out", parts[0], "--shard", "1/2", *chunks)
    assert code == 0, err
    assert "shard 1/2: 2 of 3 chunks" in out
    code, _, err = kedge("merge", parts[0], "--out", tmp_path / "joined")
    assert code == 2
    assert "found 2 of 3 chunks; missing: 1;" in err
    assert not (tmp_path / "joined").exists()
    assert kedge("study", buoy, "--out", parts[1], "--shard", "2/2", *chunks)[0] == 0
    code, _, err = kedge("merge", *parts, "--out", tmp_path / "joined", "--no-report")
    assert code == 0, err
    assert digest(tmp_path / "joined") == digest(whole)

    other = tmp_path / "other"
    assert (
        kedge("study", buoy, "--out", other, "--shard", "2/2", "--seed", "1", *chunks)[0] == 0
    )
    code, _, err = kedge("merge", parts[0], other, "--out", tmp_path / "mixed")
    assert code == 2
    assert "holds another study than" in err
    assert "(other: seed)" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--engine", "cloud"], "--engine: found 'cloud', expected one of"),
        (["--engine", "dask"], "--engine dask and --scheduler tcp://HOST:PORT go together"),
        (["--scheduler", "tcp://a:1"], "go together"),
        (["--shard", "3/2"], "--shard: found '3/2', expected i/n"),
        (["--chunk", "0"], "chunk: found 0, expected 1 or more"),
    ],
)
def test_bad_options(buoy, kedge, tmp_path, options, message):
    code, _, err = kedge("study", buoy, "--out", tmp_path / "out", *options)
    assert code == 2
    assert message in err
    assert not (tmp_path / "out").exists()


def test_folders_of_others_are_left_alone(buoy, kedge, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter").write_text("dear")
    for options in ([], ["--resume"], ["--force"]):
        code, _, err = kedge("study", buoy, "--out", tmp_path / "mine", *options)
        assert code == 2
        assert "the folder is not empty" in err
    code, _, err = kedge("study", buoy, "--shard", "1/2")
    assert code == 2
    assert "need a folder: --out DIR" in err
    code, _, err = kedge("merge", tmp_path / "mine", "--out", tmp_path / "out")
    assert code == 2
    assert "holds no chunks of a study" in err


def test_a_torn_chunk_is_done_again(tmp_path):
    with open_study(tmp_path / "s", {"seed": 1}) as folder:
        folder.save(0, {"a": np.arange(3.0)})
        folder.save(1, {"a": np.arange(4.0)})
    file = tmp_path / "s" / "chunks" / "000001.npz"
    file.write_bytes(file.read_bytes()[:40])
    with open_study(tmp_path / "s", {"seed": 1}, resume=True) as again:
        done, faults = again.survey()
        assert done == [0]
        assert "000001.npz: found a chunk that is damaged or cut off" in faults[0]
        np.testing.assert_array_equal(again.load(0)["a"], np.arange(3.0))


@pytest.mark.parametrize("listens", [False, True])
def test_a_scheduler_that_does_not_answer(buoy, kedge, tmp_path, monkeypatch, listens):
    pytest.importorskip("distributed")
    assert engines.ANSWER < 10
    monkeypatch.setattr(engines, "ANSWER", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1] if listens else 9
        where = ("--engine", "dask", "--scheduler", f"tcp://127.0.0.1:{port}")
        begin = time.monotonic()
        code, _, err = kedge("study", buoy, "--out", tmp_path / "out", *where)
    assert code == 2
    said = f"--scheduler tcp://127.0.0.1:{port}: found no answer of one within 0.5 s"
    assert said in err.splitlines()[-1]
    assert "Traceback" not in err
    assert time.monotonic() - begin < 30
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_processes_give_the_same_numbers(buoy, kedge, tmp_path):
    whole, spread = tmp_path / "whole", tmp_path / "spread"
    chunks = ("--chunk", "3", "--no-report")
    assert kedge("study", buoy, "--out", whole, *chunks)[0] == 0
    code, _, err = kedge("study", buoy, "--out", spread, *chunks, "--engine", "processes")
    assert code == 0, err
    assert digest(spread) == digest(whole)


@pytest.fixture
def cluster(tmp_path):
    """A scheduler, its address, and two workers."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    processes = [start("scheduler", "--scheduler-file", file, "--port", "0",
                       "--host", "127.0.0.1", "--no-dashboard")]  # fmt: skip
    try:
        while not file.exists():
            time.sleep(0.2)
            assert processes[0].poll() is None
        address = json.loads(file.read_text())["address"]
        for _ in range(2):
            options = "--nthreads", "1", "--no-nanny", "--no-dashboard"
            processes.append(start("worker", address, *options, "--local-directory", tmp_path))
        yield processes, address
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.parametrize("dies", ["a worker", "the scheduler"])
def test_dask_of_which_one_part_dies(buoy, tmp_path, kedge, cluster, dies):
    (scheduler, worker, _), address = cluster
    whole, spread = tmp_path / "whole", tmp_path / "spread"
    chunks = ("--chunk", "1", "--no-report")
    assert kedge("study", buoy, "--out", whole, *chunks)[0] == 0
    command = [sys.executable, "-m", "kedge.apps.cli", "study", buoy, "--out", spread,
               *chunks, "--engine", "dask", "--scheduler", address]  # fmt: skip
    running = subprocess.Popen([str(part) for part in command], stderr=subprocess.PIPE)
    while running.poll() is None and not list(spread.glob("chunks/*.npz")):
        time.sleep(0.05)
    (worker if dies == "a worker" else scheduler).send_signal(signal.SIGKILL)
    err = running.communicate(timeout=120)[1].decode()
    if dies == "the scheduler":
        assert running.returncode == 2, err
        assert "the connection was lost" in err.splitlines()[-1]
        assert "Traceback" not in err
        code, _, err = kedge("study", buoy, "--out", spread, *chunks, "--resume")
        assert code == 0, err
    else:
        assert running.returncode == 0, err
    assert digest(spread) == digest(whole)


def start(role, *options):
    command = [sys.executable, "-m", "distributed.cli.dask_" + role, *map(str, options)]
    return subprocess.Popen(
        command, env=os.environ, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
