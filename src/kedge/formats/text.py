"""Text files in the encodings that programs write."""

import gzip
import zlib
from pathlib import Path

from kedge.core.errors import DataError

MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def read_text(path: Path, notes: list[str] | None = None) -> str:
    """The text of a file, unpacked if its name ends in .gz; ``notes`` says what was odd.

    UTF-8, UTF-16 with its mark, or else Windows-1252. Zero bytes at the end are what a file
    system writes where the power failed; they are left out.

    Raises:
        DataError: it is missing, cannot be read, or is no text.
    """
    notes = [] if notes is None else notes
    try:
        data = path.read_bytes()
        if path.suffix == ".gz":
            data = gzip.decompress(data)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    encoding = next((name for mark, name in MARKS.items() if data.startswith(mark)), "utf-8")
    if encoding != "utf-16" and data.endswith(b"\0"):
        size = len(data)
        data = data.rstrip(b"\0")
        notes.append(f"{path.name}: {size - len(data)} zero bytes at the end were left out")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise DataError(f"{path}: cannot be read as {encoding}: {error.reason}") from None
        # Every byte is a letter of Latin-1: five are none in Windows-1252.
        text = data.decode("cp1252", errors="replace")
        notes.append(f"{path.name}: no UTF-8; read as Windows-1252 (Latin-1)")
    if "\0" in text:
        at = text[: text.index("\0")].count("\n") + 1
        raise DataError(f"{path}:{at}: found a zero byte, expected text")
    return text
