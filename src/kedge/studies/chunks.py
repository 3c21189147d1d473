"""The folder of a study at work: what it is, and a file of sums for each chunk that is done.

``study.json`` says which study it is; ``chunks/000003.npz`` holds a chunk and says of which
study, as which, and by a checksum that it is whole. So what an interrupted study leaves can be
gone on with, and nothing of another study is taken for it.
"""

import contextlib
import hashlib
import io
import json
import os
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kedge.core.errors import DataError
from kedge.formats.atomic import draft_in, replace_file
from kedge.formats.results import digest, plain
from kedge.formats.results_folder import (
    CHUNKS,
    MARK,
    Mark,
    check_unchanged,
    commit,
    examine,
    mark_text,
    read_mark,
    reserved_folder,
)

KIND = "study"
STUDY = "study.json"
_SEAL = re.compile(rb"kedge chunk (\d{6,}) of study ([0-9a-f]{64}), SHA-256 ([0-9a-f]{64})$")


class ChunkFolder:
    """Chunks of one study on disk. Nothing is written before the first is saved."""

    def __init__(self, path: Path, study: Mapping[str, Any], kept: bool = True):
        self.path, self.study, self.kept = path, plain(dict(study)), kept
        self.digest = study_digest(self.study)

    def survey(self) -> tuple[list[int], list[str]]:
        """The numbers of the chunks that are whole, and what is wrong with the others."""
        whole, faults = [], []
        for file in sorted((self.path / CHUNKS).glob("[0-9]*.npz")):
            if file.stem.isdigit():
                try:
                    self.read(int(file.stem))
                    whole.append(int(file.stem))
                except DataError as error:
                    faults.append(str(error))
        return whole, faults

    def save(self, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write a chunk.

        Raises:
            DataError: it cannot be written.
        """
        file, named = io.BytesIO(), dict[str, Any](arrays)
        np.savez_compressed(file, **named)
        with zipfile.ZipFile(file, "a") as archive:
            seal = f"kedge chunk {number:06d} of study {self.digest}, SHA-256 {'0' * 64}"
            archive.comment = seal.encode()
        body = file.getvalue()[:-64]
        self.write(number, body + hashlib.sha256(body).hexdigest().encode())

    def load(self, number: int) -> dict[str, np.ndarray]:
        """The arrays of a chunk.

        Raises:
            DataError: it is not there or not whole.
        """
        try:
            with np.load(io.BytesIO(self.read(number)), allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
        except (ValueError, zipfile.BadZipFile) as error:
            raise DataError(f"{self._file(number)}: cannot be read: {error}") from error

    def read(self, number: int) -> bytes:
        """The file of a chunk, whole and of this study.

        Raises:
            DataError: it is something else.
        """
        try:
            data = self._file(number).read_bytes()
        except OSError as error:
            raise DataError(
                f"{self._file(number)}: cannot be read: {error.strerror}"
            ) from error
        seal = _SEAL.search(data[-256:])
        if seal is None or hashlib.sha256(data[:-64]).hexdigest().encode() != seal[3]:
            raise DataError(
                f"{self._file(number)}: found a chunk that is damaged or cut off (its checksum "
                "is not that of its content)"
            )
        if (int(seal[1]), seal[2].decode()) != (number, self.digest):
            raise DataError(
                f"{self._file(number)}: found chunk {int(seal[1])} of study "
                f"{seal[2][:8].decode()}, expected chunk {number} of study {self.digest[:8]}"
            )
        return data

    def write(self, number: int, data: bytes) -> None:
        """Write the file of a chunk, as :meth:`read` gives it.

        Raises:
            DataError: it cannot be written.
        """
        try:
            (self.path / CHUNKS).mkdir(exist_ok=True)
        except OSError as error:
            raise DataError(f"{self.path}: cannot be written: {error.strerror}") from error
        if not (self.path / STUDY).is_file():
            text = (json.dumps(self.study, indent=2, allow_nan=False) + "\n").encode()
            # First whose the folder is: so the next run can go on wherever this one is killed.
            mark = Mark(KIND, {STUDY: hashlib.sha256(text).hexdigest()})
            replace_file(self.path / MARK, mark_text(mark))
            replace_file(self.path / STUDY, text)
        replace_file(self._file(number), data)

    @contextlib.contextmanager
    def publishing(self) -> Iterator[Path]:
        """A draft of the results, which then replace those that are beside the chunks."""
        with draft_in(self.path) as draft:
            yield draft
            mark = read_mark(self.path)
            only = {STUDY: mark.files[STUDY]} if mark else {}
            commit(draft, self.path, KIND, Mark(KIND, only))

    def _file(self, number: int) -> Path:
        return self.path / CHUNKS / f"{number:06d}.npz"


@contextlib.contextmanager
def open_study(
    path: str | os.PathLike[str],
    study: Mapping[str, Any],
    resume: bool = False,
    force: bool = False,
) -> Iterator[ChunkFolder]:
    """The folder of a study, in which nobody else writes meanwhile.

    With ``force`` the study that is there stays until the block has ended well.

    Raises:
        DataError: the folder is another study's (see ``resume`` and ``force``), or no study's.
    """
    with reserved_folder(path) as target:
        mark = examine(target, KIND)
        if mark is None or not (target / STUDY).is_file():
            yield ChunkFolder(target, study)
        elif force:
            with draft_in(target) as draft:
                yield ChunkFolder(draft, study, kept=False)
                commit(draft, target, KIND)
        elif not resume:
            raise DataError(
                f"{path}: holds a study already; --resume goes on with it, --force replaces it"
            )
        else:
            folder, present = ChunkFolder(target, study), read_study(target)
            same = study_digest(present) == folder.digest
            if not same or present.get("shard") != folder.study.get("shard"):
                keys = sorted(k for k, v in folder.study.items() if present.get(k) != v)
                raise DataError(
                    f"{path}: holds another study (other: {', '.join(keys) or 'version'}), "
                    "which --resume cannot go on with; --force replaces it"
                )
            yield folder


def read_study(path: Path) -> dict[str, Any]:
    """Which study a folder holds.

    Raises:
        DataError: it holds none that can be gone on with.
    """
    mark = read_mark(path)
    if mark is None or mark.kind != KIND or STUDY not in mark.files:
        raise DataError(f"{path}: holds no chunks of a study of this version ({MARK}, {STUDY})")
    check_unchanged(path, mark, STUDY)
    try:
        table = json.loads((path / STUDY).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"{path}: holds no chunks of a study ({STUDY} is missing)") from None
    except (OSError, ValueError) as error:
        raise DataError(f"{path / STUDY}: cannot be read: {error}") from error
    if not isinstance(table, dict):
        raise DataError(f"{path / STUDY}: found {type(table).__name__}, expected a table")
    return table


def study_digest(study: Mapping[str, Any]) -> str:
    """What shards of one study have in common, wherever its files were."""
    return digest({k: v for k, v in study.items() if k not in ("shard", "origin")})
