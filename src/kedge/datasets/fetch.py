"""Recorded data sets: where they come from, and how they get onto this machine.

Third-party recordings are never part of kedge. A data set is looked for below the folder
that ``KEDGE_DATA`` names, then in the user's cache, where ``kedge datasets fetch`` puts it once
every file is the one whose SHA-256 is known (``checksums/NAME.sha256``).
"""

import gzip
import hashlib
import os
import tempfile
import zipfile
import zlib
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from platformdirs import user_cache_path

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import unknown


class Dataset(NamedTuple):
    """A public recording."""

    title: str
    folder: str
    """Below ``KEDGE_DATA`` or the cache."""
    url: str
    """The original source: a zip archive that holds ``folder``'s last part."""
    cite: str


DATASETS = {
    "mrclam": Dataset(
        title="Five ground robots, wheel commands and camera, 15 min, Vicon truth (MRCLAM 7)",
        folder="mrclam/MRCLAM_Dataset7",
        url="ftp://asrl3.utias.utoronto.ca/MRCLAM/MRCLAM7.zip",
        cite=(
            "K. Leung, Y. Halpern, T. Barfoot, H. Liu, 'The UTIAS multi-robot cooperative "
            "localization and mapping dataset', Int. J. Robotics Research 30(8), 2011"
        ),
    ),
}


def dataset(name: str) -> Dataset:
    """Look a data set up.

    Raises:
        UnknownName: there is none of that name.
    """
    if name not in DATASETS:
        raise UnknownName(unknown("data sets", name, sorted(DATASETS)))
    return DATASETS[name]


def checksums(name: str) -> dict[str, str]:
    """SHA-256 of every file of a data set, by file name."""
    text = (files("kedge.datasets") / "checksums" / f"{name}.sha256").read_text()
    return {file: checksum for checksum, file in (line.split() for line in text.splitlines())}


def locate(name: str) -> Path | None:
    """The folder of a data set on this machine, or None."""
    entry = dataset(name)
    roots = [Path(os.environ["KEDGE_DATA"])] if os.environ.get("KEDGE_DATA") else []
    roots.append(user_cache_path("kedge") / "datasets")
    return next((root / entry.folder for root in roots if (root / entry.folder).is_dir()), None)


def require_located(name: str) -> Path:
    """The folder of a data set on this machine.

    Raises:
        DataError: it is not here; the message says how to get it.
    """
    if (folder := locate(name)) is None:
        raise DataError(
            f"data set {name!r} is not on this machine: run 'kedge datasets fetch {name}', or "
            f"let KEDGE_DATA name the folder above {dataset(name).folder}"
        )
    return folder


def log_of(log: str) -> str:
    """A log that is called by a data set's name, ``NAME`` or ``NAME#PART``, as a path.

    What exists under that name here is taken for what it is.

    Raises:
        DataError: the data set is not on this machine; the message says how to get it.
    """
    name, mark, part = log.partition("#")
    if name not in DATASETS or Path(name).exists():
        return log
    return f"{require_located(name)}{mark}{part}"


def fetch(name: str) -> Path:
    """Download a data set from its original source, check every file, and keep it.

    Raises:
        DataError: it cannot be downloaded, or a file is not the one that is known.
    """
    entry = dataset(name)
    if (folder := locate(name)) is not None:
        return folder
    try:
        import pooch
    except ImportError:
        raise DataError("downloading needs pooch: pip install 'kedge-nav[studio]'") from None
    root = user_cache_path("kedge") / "datasets"
    target = root / entry.folder
    try:
        archive = pooch.retrieve(entry.url, None, path=root, progressbar=False)
    except Exception as error:
        # Whatever the network library raises, to the user it is one thing: not reachable.
        raise DataError(f"{entry.url}: cannot be downloaded: {error}") from error
    try:
        with tempfile.TemporaryDirectory(dir=root, prefix=f".{target.name}-") as draft:
            unpacked = Path(draft) / target.name
            unpacked.mkdir()
            _unpack(Path(archive), entry.url, checksums(name), unpacked)
            target.parent.mkdir(parents=True, exist_ok=True)
            unpacked.rename(target)
    except OSError as error:
        raise DataError(f"{target}: cannot be written: {error}") from error
    finally:
        # Whether it was unpacked or is no archive: the next attempt begins with a new one.
        Path(archive).unlink(missing_ok=True)
    return target


def _unpack(archive: Path, url: str, known: dict[str, str], folder: Path) -> None:
    """Put the files that are known, and no others, into a folder.

    Raises:
        DataError: it is no archive, or a file is missing or is not the one that is known.
    """
    try:
        with zipfile.ZipFile(archive) as bundle:
            members = {Path(member).name: member for member in bundle.namelist()}
            if missing := [file for file in known if file not in members]:
                raise DataError(f"{url}: {missing[0]} is missing from the archive")
            contents = {file: bundle.read(members[file]) for file in known}
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
    ) as error:
        raise DataError(
            f"{url}: what was downloaded is no whole zip archive: {error}"
        ) from error
    for file, data in contents.items():
        found = hashlib.sha256(data).hexdigest()
        if found != known[file]:
            raise DataError(f"{url}: {file} has SHA-256 {found}, expected {known[file]}")
        (folder / file).write_bytes(data)


def verify(name: str, folder: Path) -> None:
    """Check a copy of a data set, plain or gzipped.

    Raises:
        DataError: a file is missing or is not the one that is known.
    """
    for file, checksum in checksums(name).items():
        plain, packed = folder / file, folder / f"{file}.gz"
        if plain.is_file():
            data = plain.read_bytes()
        elif packed.is_file():
            try:
                data = gzip.decompress(packed.read_bytes())
            except (OSError, EOFError, zlib.error) as error:
                raise DataError(f"{packed}: cannot be unpacked: {error}") from error
        else:
            raise DataError(f"{folder}: {file} is missing")
        if (digest := hashlib.sha256(data).hexdigest()) != checksum:
            raise DataError(f"{folder / file}: SHA-256 is {digest}, expected {checksum}")
