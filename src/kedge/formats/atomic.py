"""Files and folders that appear complete or not at all, also if the machine stops meanwhile.

What is being written is a draft under a random name, locked as long as its writer lives, so
that whoever comes next can tell a draft at work from one that a kill has left.
"""

import contextlib
import ctypes
import errno
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from kedge.core.errors import DataError
from kedge.formats.locks import LOCK, lock, locked

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # fcntl.h, linux/fs.h
_DRAFT = re.compile(r"\.kedge-[0-9a-f]{8}-[0-9a-f]{12}\.(part|whole|old)")
"""States of a draft: being written; to be moved in file by file; exchanged, or about to be."""


def replace_file(path: Path, data: bytes) -> None:
    """Write a file; a link is written to its target.

    Raises:
        DataError: it cannot be written.
    """
    target = Path(os.path.realpath(path))
    try:
        sweep(target)
        draft = draft_name(target, target.parent)
        try:
            draft.touch(exist_ok=False)
            with locked(draft):
                with draft.open("wb") as file:
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())
                draft.replace(target)
            sync(target.parent)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error


@contextlib.contextmanager
def reserved(target: Path, path: str | os.PathLike[str]) -> Iterator[None]:
    """Make a folder if it is not there, and be the only one who writes to it.

    What was made and stays empty is removed at the end.

    Raises:
        DataError: somebody else writes there, or the block ends with an error of a file.
    """
    made = []
    try:
        if target.exists() and not target.is_dir():
            raise DataError(f"{path}: is a file, expected a folder or a name that is free")
        missing = [p for p in (target, *target.parents) if not p.exists()]
        for folder in reversed(missing):
            folder.mkdir(exist_ok=True)
            made.append(folder)
        with locked(target):
            yield
    except BrokenPipeError:  # of the console
        raise
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            for folder in reversed(made):
                (folder / LOCK).unlink(missing_ok=True)
                folder.rmdir()


@contextlib.contextmanager
def draft_in(target: Path) -> Iterator[Path]:
    """A folder to write into, inside the one that it is to become: on the same disk."""
    draft = draft_name(target, target)
    draft.mkdir()
    try:
        shutil.copymode(target, draft)
        with locked(draft):
            yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def put(draft: Path, target: Path) -> Path | None:
    """Exchange a draft and its folder in one step; give what was there before, by its new name.

    None, and the draft is where it was, if that cannot be done: the folder is a disk of its
    own, somebody stands in it, or the file system cannot exchange.
    """
    if Path(os.path.realpath(os.curdir)).is_relative_to(target):
        return None
    empty = not entries(target)
    outside = target.parent / (draft.name if empty else f"{draft.stem}.old")
    try:
        draft.rename(outside)
    except OSError:
        return None
    try:
        if empty:
            (target / LOCK).unlink(missing_ok=True)
            outside.rename(target)
        else:
            exchange(outside, target)
    except OSError:
        outside.rename(draft)
        return None
    sync(target.parent)
    return outside


def exchange(first: Path, second: Path) -> None:
    """Two folders change names, in one step.

    Raises:
        OSError: system or file system cannot.

    Source: Linux man-pages, renameat2(2).
    """
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    names = os.fsencode(first), os.fsencode(second)
    if call(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def sweep(target: Path) -> None:
    """Remove the drafts that a kill has left of a file or folder, beside it and in it."""
    for draft in leftovers(target, "part"):
        if draft.is_dir():
            shutil.rmtree(draft)
        else:
            draft.unlink(missing_ok=True)


def leftovers(target: Path, state: str) -> Iterator[Path]:
    """Drafts of a file or folder whose writers are dead, each locked while it is looked at."""
    beside = f".kedge-{_key(target)}-*.{state}"
    found = [*target.parent.glob(beside), *target.glob(f".kedge-*.{state}")]
    for draft in found:
        if not _DRAFT.fullmatch(draft.name):
            continue
        with contextlib.suppress(OSError):
            if (descriptor := lock(draft)) is not None:
                try:
                    yield draft
                finally:
                    os.close(descriptor)


def entries(folder: Path) -> list[Path]:
    """What is in a folder, without drafts and locks."""
    return [p for p in folder.iterdir() if p.name != LOCK and not _DRAFT.fullmatch(p.name)]


def draft_name(target: Path, folder: Path) -> Path:
    """A random name for a draft; no longer if the target's name is long."""
    return folder / f".kedge-{_key(target)}-{secrets.token_hex(6)}.part"


def sync_tree(folder: Path) -> None:
    """Have all that is in a folder on the disk."""
    for root, _, files in os.walk(folder):
        for path in (*(Path(root) / name for name in files), Path(root)):
            sync(path)


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk."""
    if os.name == "nt":  # opens no folder
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _key(target: Path) -> str:
    return hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
