"""Locks on files and folders. The system takes them back however their process ends."""

import contextlib
import os
import warnings
from collections.abc import Iterator
from pathlib import Path

from kedge.core.errors import DataError

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None

LOCK = ".kedge-lock"
"""Stands for a folder where folders themselves cannot be locked."""


def lock(path: Path) -> int | None:
    """Lock a file or folder: a descriptor to be closed, or None while somebody has the lock.

    Process numbers say nothing across containers; these locks are the kernel's.

    Raises:
        OSError: nothing can be locked here.
    """
    if fcntl is None:
        raise OSError(f"{path}: this system has no locks of files")
    descriptor = os.open(path, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:
            # Network file systems lock only what is open for writing, which a folder never is.
            if not path.is_dir():
                raise
            os.close(descriptor)
            descriptor = os.open(path / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:
        with contextlib.suppress(OSError):
            os.close(descriptor)
        raise
    try:
        same = os.path.samestat(os.fstat(descriptor), os.stat(path))
    except OSError:
        same = False
    if same or os.path.exists(path / LOCK):
        return descriptor
    os.close(descriptor)  # it was replaced just now: somebody is at work
    return None


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Be the only one who writes to a file or folder.

    Raises:
        DataError: somebody else writes there.
    """
    try:
        descriptor = lock(path)
    except OSError as error:
        text = f"{path}: cannot be locked, let nobody else write there: {error}"
        warnings.warn(text, stacklevel=2)
        yield
        return
    if descriptor is None:
        raise DataError(f"{path}: another kedge is writing there, wait until it has ended")
    try:
        yield
    finally:
        os.close(descriptor)
