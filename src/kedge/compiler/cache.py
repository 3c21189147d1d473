"""Machine code on disk: what is run was written by this user, whole, and for this very key.

A folder or a file that somebody else could have written is not used, an entry that is damaged
is compiled anew; each is said once. A disk that is full or cannot be written costs the cache.
"""

import contextlib
import functools as ft
import hashlib
import os
import stat
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from platformdirs import user_cache_path

MARK = b"kedge machine code 1\n"
STALE = 3600.0
"""Seconds after which a draft is that of a process that was killed."""


def cache_folder() -> Path:
    """Where compiled functions are kept: ``KEDGE_NATIVE_CACHE`` or the user's cache."""
    given = os.environ.get("KEDGE_NATIVE_CACHE")
    return Path(given) if given else user_cache_path("kedge") / "machine-code"


def load(key: str) -> bytes | None:
    """The code that was kept under a key (SHA-256, hexadecimal), None if it is to be made."""
    folder = _folder()
    if folder is None:
        return None
    path = folder / f"{key}.o"
    # A pipe must not hold us up, and a link is not followed.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        with open(os.open(path, flags | getattr(os, "O_BINARY", 0)), "rb") as file:
            objection = _objection(os.fstat(file.fileno()), stat.S_ISREG, 0o022)
            content = b"" if objection else file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        objection, content = f"cannot be read ({error.strerror})", b""
    begin = len(_header(key, b""))
    code = content[begin:]
    if objection is None and content[:begin] != _header(key, code):
        objection = "is damaged"
    if objection:
        _warn(f"{path} {objection}: compiled anew")
        return None
    return code


def store(key: str, code: bytes) -> None:
    """Keep code under a key: whole or not at all, also if the machine stops meanwhile."""
    folder = _folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        for draft in folder.glob(".*.part"):
            if time.time() - draft.lstat().st_mtime > STALE:
                draft.unlink()
    with contextlib.suppress(OSError):
        descriptor, draft = tempfile.mkstemp(".part", ".", folder)
        try:
            with open(descriptor, "wb") as file:
                file.write(_header(key, code) + code)
                file.flush()
                os.fsync(descriptor)
            os.replace(draft, folder / f"{key}.o")
        except BaseException:
            os.unlink(draft)
            raise


def _header(key: str, code: bytes) -> bytes:
    return MARK + bytes.fromhex(key) + hashlib.sha256(code).digest()


def _folder() -> Path | None:
    """The cache's folder, None if there is none or others have a hand in it."""
    path = cache_folder()
    try:
        with contextlib.suppress(FileExistsError):
            path.mkdir(0o700, parents=True)
        status = path.lstat()
    except OSError:
        return None
    objection = _objection(status, stat.S_ISDIR, 0o077)
    if objection:
        _warn(
            f"the cache of machine code {path} {objection}, so it is not used; expected a "
            "folder of the user's own, closed to others (chmod 700)"
        )
        return None
    return path


def _objection(
    status: os.stat_result, is_kind: Callable[[int], bool], forbidden: int
) -> str | None:
    if not is_kind(status.st_mode):
        return f"is a link or no {'folder' if is_kind is stat.S_ISDIR else 'file'}"
    if os.name != "posix":  # access is not said by these bits
        return None
    if status.st_uid != os.geteuid():
        return f"belongs to another user (number {status.st_uid})"
    if status.st_mode & forbidden:
        return f"is open to others (mode {stat.S_IMODE(status.st_mode):o})"
    return None


@ft.cache
def _warn(message: str) -> None:
    """Once in a process."""
    warnings.warn(message, stacklevel=2)
