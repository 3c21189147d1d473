"""Folders of results, in which kedge replaces what it wrote itself and nothing else.

The mark ``kedge.json`` says which command wrote a folder and lists the files with the SHA-256
of each. What is not listed, or is no longer what was written, is never touched.
"""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from kedge import __version__
from kedge.core.errors import DataError
from kedge.formats.atomic import (
    draft_in,
    entries,
    leftovers,
    put,
    replace_file,
    reserved,
    sweep,
    sync,
    sync_tree,
)

MARK = "kedge.json"
CHUNKS = "chunks"
"""A folder of a study's own; its files carry their checksums themselves."""


class Mark(NamedTuple):
    """What a command wrote into a folder."""

    kind: str
    files: dict[str, str]
    """Path in the folder, with slashes: SHA-256."""


@contextlib.contextmanager
def fresh_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a hidden folder to write into; it becomes ``path`` once the block has ended well.

    Raises:
        DataError: the folder has something in it already, or cannot be written.
    """
    with reserved_folder(path) as target, draft_in(target) as draft:
        if entries(target):
            raise _not_empty(target)
        yield draft
        commit(draft, target, None)


@contextlib.contextmanager
def results_folder(
    path: str | os.PathLike[str], kind: str, force: bool = False
) -> Iterator[Path]:
    """The same, but what a command of this kind wrote there earlier is replaced.

    With ``force`` also those of its files that were changed since, once the block has ended
    well; never a file that it did not write.

    Raises:
        DataError: the folder has something in it that is not such a result, or is no longer
            as it was written; or it cannot be written.
    """
    with reserved_folder(path) as target, draft_in(target) as draft:
        mark = examine(target, kind, force)
        yield draft
        if force and mark is not None:
            present = [name for name in mark.files if os.path.lexists(target / name)]
            as_it_is = Mark(kind, {name: _digest(target, name) for name in present})
            replace_file(target / MARK, mark_text(as_it_is))
        commit(draft, target, kind)


@contextlib.contextmanager
def reserved_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Be the only one who writes to a folder, with what a kill has interrupted there ended."""
    target = Path(os.path.realpath(path))
    with reserved(target, path):
        recover(target)
        yield target


def examine(target: Path, kind: str | None, changed: bool = False) -> Mark | None:
    """What a command may replace in a folder, also if ``changed``; None if it is empty.

    Raises:
        DataError: it may not replace what is there.
    """
    if not entries(target):
        return None
    mark = None if kind is None else read_mark(target)
    if mark is None:
        raise _not_empty(target)
    if mark.kind != kind:
        raise DataError(
            f"{target}: holds what 'kedge {mark.kind}' wrote, which 'kedge {kind}' does not "
            "replace; choose another folder"
        )
    for name in () if changed else mark.files:
        check_unchanged(target, mark, name)
    return mark


def check_unchanged(folder: Path, mark: Mark, name: str) -> None:
    """See that a file is as it was written, or not there.

    Raises:
        DataError: it is something else.
    """
    path = folder / name
    if (path.exists() or path.is_symlink()) and _digest(folder, name) != mark.files[name]:
        raise DataError(
            f"{path}: was changed since kedge wrote it; move it away (or delete it), or choose "
            "another folder"
        )


def read_mark(folder: Path) -> Mark | None:
    """The mark of a folder, if it has one.

    Raises:
        DataError: it cannot be understood.
    """
    path = folder / MARK
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        mark = Mark(table["kind"], table["files"])
        texts = [mark.kind, *mark.files, *mark.files.values()]
        safe = all(
            name and not name.startswith("/") and ".." not in name.split("/")
            for name in mark.files
        )
        if not safe or not all(isinstance(text, str) for text in texts):
            raise ValueError("expected names of files in this folder, and their SHA-256")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DataError(f"{path}: is no list of kedge's files: {error}") from error
    return mark


def mark_of(folder: Path, kind: str) -> Mark:
    """Kind and digests of all that is in a folder, but for a study's chunks."""
    names = set(_leaves(folder)) - {MARK, *_chunks(folder)}
    return Mark(kind, {name: _digest(folder, name) for name in sorted(names)})


def mark_text(mark: Mark) -> bytes:
    """A mark as it stands in its file."""
    table = {"kedge": __version__, "kind": mark.kind, "files": mark.files}
    return (json.dumps(table, indent=2) + "\n").encode()


def commit(draft: Path, target: Path, kind: str | None, also: Mark | None = None) -> None:
    """Put what is in a draft into its folder, in place of what kedge wrote there earlier.

    In one step if nothing else is in the folder. Otherwise what is not kedge's stays where it
    is: the old files are removed one by one and the new ones moved in, ``summary.json`` last;
    the next run goes on with that if it is interrupted.

    Args:
        draft: all of it is written.
        target: its folder, which is reserved.
        kind: the command that wrote it; without one there is no mark.
        also: files that are in the folder already, and stay.

    Raises:
        DataError: something in the folder is not kedge's and bears the name of a new file, or
            a file there has changed meanwhile.
    """
    if kind is not None:
        files = mark_of(draft, kind).files | (also.files if also else {})
        (draft / MARK).write_bytes(mark_text(Mark(kind, files)))
    sync_tree(draft)
    before = examine(target, kind)
    old = {MARK, *before.files, *_chunks(target)} if before else set()
    foreign = any(name not in old for name in _leaves(target))
    if also is None and not foreign and (outside := put(draft, target)) is not None:
        if outside.exists():
            _clear(outside, target)
        return
    for name in _leaves(draft):
        if name not in old and os.path.lexists(target / name) and not (draft / name).is_dir():
            raise _in_the_way(target / name)
    whole = draft.rename(draft.with_suffix(".whole"))
    sync(target)
    _move_in(whole, target)


def recover(target: Path) -> None:
    """End what a kill has interrupted, and remove what it has left.

    Raises:
        DataError: a file is in the way.
    """
    for whole in leftovers(target, "whole"):
        _move_in(whole, target)
    for old in leftovers(target, "old"):
        _clear(old, target)
    sweep(target)


def _move_in(whole: Path, target: Path) -> None:
    """Replace a folder's files by those of a draft; may be interrupted and done again."""
    new, before = read_mark(whole), read_mark(target)
    same = new is not None and before == new
    if new is not None and before is not None and not same:
        for name in before.files:
            if new.files.get(name) != before.files[name]:
                check_unchanged(target, before, name)
        gone = [n for n in before.files if new.files.get(n) != before.files[n]]
        gone += _chunks(target) if (whole / CHUNKS).is_dir() else []
        _remove(target, [*gone, MARK])
    # The mark goes last: as long as it is in the draft, the folder is not yet whole.
    late = ("summary.json", MARK)
    for name in sorted(_leaves(whole), key=lambda name: (name in late, name == MARK)):
        path = target / name
        if (whole / name).is_dir():  # empty, or emptied before the kill
            path.mkdir(parents=True, exist_ok=True)
            continue
        if os.path.lexists(path) and not same and name != MARK:
            # What is the same as before was left where it is.
            if new is None or _digest(target, name) != new.files.get(name):
                raise _in_the_way(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        (whole / name).replace(path)
        sync(path.parent)
    shutil.rmtree(whole)


def _clear(old: Path, target: Path) -> None:
    """Remove what kedge wrote of a folder that was replaced; bring home what came meanwhile."""
    sweep(old)
    if mark := read_mark(old):
        _remove(old, [*mark.files, *_chunks(old)])
    for path in entries(old):
        if path.name != MARK and not os.path.lexists(target / path.name):
            path.rename(target / path.name)
    if {path.name for path in entries(old)} <= {MARK}:
        shutil.rmtree(old)


def _remove(folder: Path, names: Sequence[str]) -> None:
    """Remove files, and the folders that are empty then."""
    for name in names:
        (folder / name).unlink(missing_ok=True)
    for parent in sorted({(folder / name).parent for name in names} - {folder}, reverse=True):
        with contextlib.suppress(OSError):
            parent.rmdir()


def _leaves(folder: Path) -> Iterator[str]:
    """Every file and every empty folder, by its path in a folder; drafts and locks apart."""
    for path in entries(folder):
        inner = entries(path) if path.is_dir() and not path.is_symlink() else []
        yield from (f"{path.name}/{name}" for name in _leaves(path)) if inner else (path.name,)


def _chunks(folder: Path) -> list[str]:
    """The files of a study's chunks."""
    return [f"{CHUNKS}/{p.name}" for p in (folder / CHUNKS).glob("*.npz") if p.stem.isdigit()]


def _digest(folder: Path, name: str) -> str:
    """SHA-256 of a file; of none that a link leads to."""
    path = folder / name
    if os.path.realpath(path) != os.path.join(os.path.realpath(folder), *name.split("/")):
        return "a link"
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except IsADirectoryError:
        return "a folder"


def _in_the_way(path: Path) -> DataError:
    return DataError(f"{path}: was not written by kedge, and is not replaced; move it away")


def _not_empty(target: Path) -> DataError:
    return DataError(
        f"{target}: the folder is not empty and not kedge's (it has no {MARK}), expected an "
        "empty or a new one"
    )
