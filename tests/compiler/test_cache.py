"""The cache of machine code: nothing that is damaged or another user's is run."""

import errno
import os
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from kedge.compiler import cache, machine

KEY, CODE = "5e" * 32, bytes(range(200))
TEXT = f"define void @{machine.NAME}(ptr %block) {{ store i64 42, ptr %block\n ret void }}\n"
POSIX = pytest.mark.skipif(os.name != "posix", reason="access is not said by bits here")
ROOT = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away"
)
NOBODY = 65534


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    path = tmp_path / "code"
    monkeypatch.setenv("KEDGE_NATIVE_CACHE", str(path))
    cache._warn.cache_clear()
    return path


@pytest.fixture
def entry(folder):
    cache.store(KEY, CODE)
    return folder / f"{KEY}.o"


def answer():
    block = np.zeros(1, np.int64)
    code = machine.compile_text(TEXT)  # it lives while it is run
    code.call(block.ctypes.data)
    return block[0]


def assert_refused(match):
    """Not loaded, and said so in one line, once."""
    with pytest.warns(UserWarning, match=match):
        assert cache.load(KEY) is None
    with warnings.catch_warnings(action="error"):
        assert cache.load(KEY) is None


def test_what_is_kept_comes_back(entry):
    assert cache.load(KEY) == CODE
    assert cache.load("11" * 32) is None
    assert [path.name for path in entry.parent.iterdir()] == [entry.name]


@POSIX
def test_folder_and_entries_are_the_users_alone(entry):
    assert entry.parent.stat().st_mode & 0o777 == 0o700
    assert entry.stat().st_mode & 0o777 == 0o600


def test_compiled_once(folder, monkeypatch):
    pytest.importorskip("llvmlite")
    assert answer() == 42
    monkeypatch.setattr(machine, "_compiled", lambda text: pytest.fail("compiled again"))
    assert answer() == 42


def test_an_entry_cut_anywhere_is_refused(entry):
    whole = entry.read_bytes()
    for length in range(len(whole)):
        entry.write_bytes(whole[:length])
        assert_refused("damaged: compiled anew")
        cache._warn.cache_clear()
    entry.write_bytes(whole + b"\0")
    assert_refused("damaged")


def test_an_entry_with_any_byte_changed_is_refused(entry):
    whole = entry.read_bytes()
    for place in range(len(whole)):
        garbled = bytearray(whole)
        garbled[place] ^= 1 << place % 8
        entry.write_bytes(garbled)
        assert_refused("damaged")
        cache._warn.cache_clear()


def test_an_entry_for_another_key_is_refused(entry):
    entry.rename(entry.with_name(f"{'22' * 32}.o"))
    with pytest.warns(UserWarning, match="damaged"):
        assert cache.load("22" * 32) is None


@pytest.mark.parametrize("part", [0.0, 0.02, 0.1, 0.5, 0.99])
def test_a_damaged_entry_is_replaced_by_a_good_one(folder, part):
    """Cut in the mark, in the digests, at the code's beginning, within it, and at its end."""
    pytest.importorskip("llvmlite")
    assert answer() == 42
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.warns(UserWarning, match="damaged"):
        assert answer() == 42
    assert path.read_bytes() == whole
    with warnings.catch_warnings(action="error"):
        assert answer() == 42


@POSIX
@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_an_entry_that_others_can_write_is_refused(entry, mode):
    entry.chmod(mode)
    assert_refused("open to others")
    cache.store(KEY, CODE)
    assert cache.load(KEY) == CODE


@ROOT
def test_an_entry_of_another_user_is_refused_and_replaced(entry):
    os.chown(entry, NOBODY, NOBODY)
    assert_refused("belongs to another user")
    cache.store(KEY, CODE)
    assert entry.stat().st_uid == os.geteuid()
    assert cache.load(KEY) == CODE


@POSIX
def test_a_link_a_pipe_and_a_folder_are_no_entries(entry, tmp_path):
    elsewhere = entry.rename(tmp_path / "elsewhere.o")
    entry.symlink_to(elsewhere)
    assert_refused("cannot be read")
    cache.store(KEY, CODE[:7])
    assert cache.load(KEY) == CODE[:7]
    assert elsewhere.read_bytes().endswith(CODE), "the link was written through"
    entry.unlink()
    os.mkfifo(entry)
    assert_refused("no file")
    entry.unlink()
    entry.mkdir()
    assert_refused("cannot be read")
    cache.store(KEY, CODE)  # in vain, and without an error
    assert os.listdir(entry.parent) == [entry.name]


@POSIX
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o755])
def test_a_folder_that_others_can_enter_is_not_used(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    assert_refused("open to others.*not used.*chmod 700")
    cache.store(KEY, CODE)
    assert os.listdir(folder) == []


@ROOT
def test_a_folder_of_another_user_is_not_used(entry):
    os.chown(entry.parent, NOBODY, NOBODY)
    entry.write_bytes(b"what the other user wrote")
    assert_refused("belongs to another user.*not used")
    cache.store(KEY, CODE)
    assert entry.read_bytes() == b"what the other user wrote"


@POSIX
def test_a_link_or_a_file_is_no_folder(entry, tmp_path, monkeypatch):
    link = tmp_path / "link"
    link.symlink_to(entry.parent)
    for path in (link, entry):
        monkeypatch.setenv("KEDGE_NATIVE_CACHE", str(path))
        assert_refused("link or no folder")
        cache.store(KEY, b"new")
    assert entry.read_bytes().endswith(CODE)


def test_a_disk_that_takes_nothing_costs_only_the_cache(folder, monkeypatch):
    pytest.importorskip("llvmlite")

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert answer() == 42
    assert os.listdir(folder) == []
    folder.rmdir()
    folder.parent.joinpath("file").write_text("")
    monkeypatch.setenv("KEDGE_NATIVE_CACHE", str(folder.parent / "file" / "code"))
    assert answer() == 42


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs a file system of no files")
def test_a_folder_that_cannot_be_made_costs_only_the_cache(monkeypatch):
    monkeypatch.setenv("KEDGE_NATIVE_CACHE", "/proc/kedge/code")
    cache.store(KEY, CODE)
    assert cache.load(KEY) is None


def test_drafts_of_processes_that_were_killed_are_swept(entry):
    stale, fresh = (entry.with_name(f".{name}.part") for name in ("stale", "fresh"))
    for draft in (stale, fresh):
        draft.write_bytes(b"half")
    long_ago = time.time() - 2 * cache.STALE
    os.utime(stale, (long_ago, long_ago))
    cache.store(KEY, CODE)
    assert sorted(entry.parent.iterdir()) == [fresh, entry]


BUSY = """
import sys, warnings
from kedge.compiler import cache
warnings.simplefilter("error")
code = bytes(range(256)) * 400
for _ in range(300):
    cache.store("5e" * 32, code)
    assert cache.load("5e" * 32) == code
"""


def test_two_processes_at_once_never_see_half_an_entry(folder):
    both = [
        subprocess.Popen([sys.executable, "-c", BUSY], stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in both:
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
    assert len(os.listdir(folder)) == 1
