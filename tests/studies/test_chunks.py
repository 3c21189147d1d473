"""A study's folder: what is damaged or another study's is seen, and nothing whole is lost."""

import errno
import json
import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from fixtures.studies import buoy_text
from kedge.apps import study
from kedge.core.errors import DataError
from kedge.studies import chunks, engines
from kedge.studies.chunks import open_study

OPTIONS = ("--chunk", "3", "--no-report")


@pytest.fixture
def buoy(tmp_path):
    path = tmp_path / "buoy.toml"
    path.write_text(buoy_text(runs=8))
    return path


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Where the study of which tests spoil copies is run, once."""
    return tmp_path_factory.mktemp("original") / "whole"


@pytest.fixture
def whole(original, buoy, kedge, tmp_path):
    """A study's folder with three chunks."""
    if not original.exists():
        code, _, err = kedge("study", buoy, "--out", original, *OPTIONS)
        assert code == 0, err
    return Path(shutil.copytree(original, tmp_path / "whole"))


def figures(folder):
    return json.loads((folder / "summary.json").read_text())["digest"]["all"]


def tree(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def copied(folder):
    shutil.copy(folder / "chunks" / "000001.npz", folder / "chunks" / "000002.npz")
    return "found chunk 1 of study", "expected chunk 2"


def a_bit_flipped(folder):
    path = folder / "chunks" / "000002.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    return ("its checksum is not that of its content",)


def written_by_hand(folder):
    path = folder / "chunks" / "000002.npz"
    with np.load(path) as arrays:
        changed = {name: arrays[name][None] for name in arrays.files}
    np.savez_compressed(path, **changed)
    return ("damaged or cut off",)


def of_another_seed(folder):
    with open_study(folder.with_name("other"), {"seed": 5}) as other:
        other.save(2, {"a": np.zeros(3)})
    shutil.copy(other.path / "chunks" / "000002.npz", folder / "chunks")
    return "found chunk 2 of study", "expected chunk 2 of study"


@pytest.mark.parametrize("spoil", [copied, a_bit_flipped, written_by_hand, of_another_seed])
def test_a_chunk_that_is_not_the_studys(whole, buoy, kedge, tmp_path, spoil):
    before = figures(whole)
    complaint = spoil(whole)
    code, _, err = kedge("merge", whole, "--out", tmp_path / "joined", "--no-report")
    assert code == 2
    assert all(part in err.splitlines()[-1] for part in ("000002.npz: ", *complaint))
    assert not (tmp_path / "joined").exists()

    code, _, err = kedge("study", buoy, "--out", whole, *OPTIONS, "--resume")
    assert code == 0, err
    assert all(part in err for part in (*complaint, "; it is computed again"))
    assert "2 of 3 chunks are there already" in err
    assert figures(whole) == before


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format": 2}', "[" * 10_000])
def test_a_damaged_study_json(whole, buoy, kedge, tmp_path, text):
    (whole / "study.json").write_text(text)
    for command in (
        ("merge", whole, "--out", tmp_path / "joined"),
        ("study", buoy, "--out", whole, *OPTIONS, "--resume"),
    ):
        code, _, err = kedge(*command)
        assert code == 2
        assert "study.json: was changed since kedge wrote it" in err.splitlines()[-1]


def interrupted(job, numbers, progress):
    """An engine that is asked to end after its first chunk."""
    for number, arrays in engines.local(job, numbers, progress):
        yield number, arrays
        os.kill(os.getpid(), signal.SIGTERM)


def test_a_study_is_kept_until_the_forced_one_is_whole(
    whole, buoy, kedge, tmp_path, monkeypatch
):
    (whole / "notes.txt").write_text("mine")
    before = tree(whole)
    forced = ("study", buoy, "--out", whole, *OPTIONS, "--force", "--seed", "3")
    with monkeypatch.context() as patch:
        patch.setattr(study, "chosen", lambda *_: interrupted)
        code, out, err = kedge(*forced)
    assert (code, out) == (130, "")
    assert f"nothing new is kept; {whole} holds what it held" in err.splitlines()[-1]
    assert tree(whole) == before
    code, _, err = kedge(*forced)
    assert code == 0, err
    assert json.loads((whole / "study.json").read_text())["seed"] == 3
    assert (whole / "notes.txt").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["buoy.toml", "whole"]


def test_a_request_to_end_is_a_ctrl_c(buoy, kedge, tmp_path, monkeypatch):
    cut = tmp_path / "cut"
    handler = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        patch.setattr(study, "chosen", lambda *_: interrupted)
        code, _, err = kedge("study", buoy, "--out", cut, *OPTIONS)
    assert code == 130
    said = f"interrupted; 1 of 3 chunks are kept in {cut}; --resume goes on"
    assert said in err.splitlines()[-1]
    assert signal.getsignal(signal.SIGTERM) is handler


def test_two_studies_never_share_a_folder(buoy, kedge, tmp_path):
    with open_study(tmp_path / "out", {"seed": 1}) as folder:
        folder.save(0, {"a": np.zeros(3)})
        for options in ([], ["--resume"], ["--force"]):
            code, _, err = kedge("study", buoy, "--out", tmp_path / "out", *OPTIONS, *options)
            assert code == 2
            assert "another kedge is writing there" in err.splitlines()[-1]
    assert list((tmp_path / "out" / "chunks").iterdir()) == [folder.path / "chunks/000000.npz"]


@pytest.mark.parametrize("full", ["chunks", "results"])
def test_a_full_disk_is_one_line(buoy, kedge, tmp_path, monkeypatch, full):
    out = tmp_path / "out"
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fails(*_):
        raise error

    with monkeypatch.context() as patch:
        if full == "results":
            patch.setattr(study, "write_study", fails)
        else:
            write = chunks.replace_file
            patch.setattr(
                chunks,
                "replace_file",
                lambda p, d: (fails if "0002" in p.name else write)(p, d),
            )
        code, printed, err = kedge("study", buoy, "--out", out, *OPTIONS)
    assert (code, printed) == (2, "")
    assert err.splitlines()[-1] == f"kedge: {out}: cannot be written: No space left on device"
    assert not list(out.rglob("*.part"))
    code, _, err = kedge("study", buoy, "--out", out, *OPTIONS, "--resume")
    assert code == 0, err
    assert f"{3 if full == 'results' else 2} of 3 chunks are there already" in err


def test_a_folder_that_only_has_its_mark_is_begun_anew(tmp_path):
    with open_study(tmp_path / "out", {"seed": 1}) as folder:
        folder.save(0, {"a": np.zeros(3)})
    (tmp_path / "out" / "study.json").unlink()
    with open_study(tmp_path / "out", {"seed": 2}) as folder:
        assert folder.survey()[0] == []
        folder.save(0, {"a": np.zeros(3)})
    with pytest.raises(DataError, match="holds a study already"), open_study(folder.path, {}):
        pass


def test_without_a_folder_the_figures_are_the_same(whole, buoy, kedge):
    code, printed, err = kedge("study", buoy, *OPTIONS, "--json")
    assert code == 0, err
    assert json.loads(printed)["digest"]["all"] == figures(whole)
