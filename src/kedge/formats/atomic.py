"""Folders that appear complete or not at all."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from kedge.core.errors import DataError


@contextlib.contextmanager
def fresh_folder(path: str | os.PathLike[str], ours: str | None = None) -> Iterator[Path]:
    """Give a hidden folder to write into; it becomes ``path`` once the block has ended well.

    Args:
        path: the folder to appear; its missing parents are made.
        ours: a file that marks a folder as written by kedge. Such a folder is replaced as a
            whole; without the mark nothing that exists is touched.

    Raises:
        DataError: the folder has something in it already, or cannot be written.
    """
    target = Path(os.path.abspath(path))
    _refuse(target, ours)
    # A sibling of the first folder to be made: on the same disk, so that renaming is atomic.
    anchor = target
    while not anchor.parent.exists():
        anchor = anchor.parent
    draft = anchor.parent / f".{target.name}.{os.getpid()}.part"
    try:
        draft.mkdir()
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        yield draft
        _refuse(target, ours)
        _replace(draft, target)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def replace_file(path: Path, data: bytes) -> None:
    """Write a file that appears complete or not at all, also if the machine stops meanwhile.

    Raises:
        DataError: it cannot be written.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def _refuse(target: Path, ours: str | None) -> None:
    if target.exists() and not target.is_dir():
        raise DataError(f"{target}: is a file, expected a folder or a name that is free")
    try:
        filled = target.is_dir() and any(target.iterdir())
    except OSError as error:
        raise DataError(f"{target}: cannot be written: {error.strerror}") from error
    if filled and not (ours and (target / ours).is_file()):
        raise DataError(
            f"{target}: the folder is not empty, expected an empty or a new one"
            + (f" (or one with {ours}, which is replaced)" if ours else "")
        )


def _replace(draft: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.exists():
        draft.rename(target)
        return
    old = target.with_name(f".{target.name}.{os.getpid()}.old")
    target.rename(old)
    try:
        draft.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
