"""The folder of a study at work: what it is, and a file of sums for each chunk that is done.

``study.json`` says which study it is; ``chunks/000003.npz`` holds a chunk. Both appear complete
or not at all, so that what an interrupted study leaves can be gone on with.
"""

import io
import json
import os
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kedge.core.errors import DataError
from kedge.formats.atomic import replace_file
from kedge.formats.results import digest, plain

MARK = "study.json"
RESULTS = ("summary.json", "table.csv", "runs.csv", "report.html", "figures")
"""What is written when all chunks are there."""


class ChunkFolder:
    """Chunks of one study on disk. Nothing is made or removed before the first is saved.

    Raises:
        DataError: the folder is another study's (see ``resume`` and ``force``), or no study's.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        study: Mapping[str, Any],
        resume: bool = False,
        force: bool = False,
    ):
        self.path, self.study = Path(path), plain(dict(study))
        self._replaces = False
        if self.path.exists() and not self.path.is_dir():
            raise DataError(f"{path}: is a file, expected a folder or a name that is free")
        if not self.path.is_dir() or not any(self.path.iterdir()):
            return
        ours = [name for name in (MARK, "summary.json") if (self.path / name).is_file()]
        if not ours:
            raise DataError(f"{path}: the folder is not empty, expected an empty or a new one")
        if force:
            self._replaces = True
        elif not resume:
            raise DataError(
                f"{path}: holds a study already; --resume goes on with it, --force replaces it"
            )
        elif study_digest(found := read_study(self.path)) != study_digest(self.study) or (
            found.get("shard") != self.study.get("shard")
        ):
            keys = sorted(k for k in self.study if found.get(k) != self.study[k])
            raise DataError(
                f"{path}: holds another study (other: {', '.join(keys) or 'version'}), which "
                "--resume cannot go on with; --force replaces it"
            )

    def done(self) -> list[int]:
        """The numbers of the chunks that are there whole."""
        if self._replaces:
            return []
        files = sorted((self.path / "chunks").glob("[0-9]*.npz"))
        return [int(file.stem) for file in files if zipfile.is_zipfile(file)]

    def save(self, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write a chunk.

        Raises:
            DataError: it cannot be written.
        """
        self._open()
        file = io.BytesIO()
        named: dict[str, Any] = dict(arrays)
        np.savez_compressed(file, **named)
        replace_file(self._file(number), file.getvalue())

    def load(self, number: int) -> dict[str, np.ndarray]:
        """Read a chunk.

        Raises:
            DataError: it is not there or cannot be read.
        """
        try:
            with np.load(self._file(number), allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise DataError(f"{self._file(number)}: cannot be read: {error}") from error

    def publish(self, draft: Path) -> None:
        """Move results from a draft folder to this one, ``summary.json`` last."""
        self._open()
        present = [name for name in RESULTS if (draft / name).exists()]
        for name in (*present[1:], *present[:1]):
            target = self.path / name
            if target.is_dir():
                shutil.rmtree(target)
            (draft / name).replace(target)

    def _open(self) -> None:
        """Make the folder, without what it replaces, and say whose it is."""
        try:
            if self._replaces:
                for name in ("chunks", MARK, *RESULTS):
                    target = self.path / name
                    if target.is_dir():
                        shutil.rmtree(target)
                    else:
                        target.unlink(missing_ok=True)
                self._replaces = False
            (self.path / "chunks").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"{self.path}: cannot be written: {error.strerror}") from error
        if not (self.path / MARK).is_file():
            text = json.dumps(self.study, indent=2, allow_nan=False) + "\n"
            replace_file(self.path / MARK, text.encode())

    def _file(self, number: int) -> Path:
        return self.path / "chunks" / f"{number:06d}.npz"


def read_study(path: Path) -> dict[str, Any]:
    """Which study a folder holds.

    Raises:
        DataError: it holds none that can be gone on with.
    """
    try:
        found = json.loads((path / MARK).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"{path}: holds no chunks of a study ({MARK} is missing)") from None
    except (OSError, ValueError) as error:
        raise DataError(f"{path / MARK}: cannot be read: {error}") from error
    if not isinstance(found, dict):
        raise DataError(f"{path / MARK}: found {type(found).__name__}, expected a table")
    return found


def study_digest(study: Mapping[str, Any]) -> str:
    """What shards of one study have in common, wherever its files were."""
    return digest({k: v for k, v in study.items() if k not in ("shard", "origin")})
