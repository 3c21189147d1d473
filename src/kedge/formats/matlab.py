"""Matrices and structures of numbers from MATLAB files, each length checked before it is used.

SciPy's reader takes the file's word for its sizes: a damaged file of 2 kB asks for gigabytes,
or ends the process. Here nothing is reserved that the file's own bytes cannot fill.

Source: MathWorks, "MAT-File Format", version 5, 2024, chapter 1, level 5.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.registry import unknown

Matrix = Float[np.ndarray, "..."]
Order = Literal["<", ">"]

# Codes of data types and of array classes.
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
STORED |= {12: "i8", 13: "u8"}
MATRIX, COMPRESSED = 14, 15
STRUCTURE, NUMERIC = 2, range(6, 16)
COMPLEX = 0x800
HEADER = 128
MOST_BYTES = 2**31
"""Of one variable, by the format's own limit."""
DEFLATED = 1032
"""No byte that is packed stands for more (zlib's documentation)."""
HEAD = 4096
"""Bytes that hold a variable's name for certain."""


def read_matrix(path: Path, name: str) -> Matrix:
    """A matrix of real numbers.

    Raises:
        DataError: the file cannot be read, or has no such matrix.
    """
    found = _variable(path, name, "matrix")
    if isinstance(found, np.ndarray):
        return found
    raise DataError(f"{path}: {name}: found a structure, expected a matrix")


def read_structure(path: Path, name: str) -> Mapping[str, Matrix]:
    """The fields of a structure that are matrices of real numbers.

    Raises:
        DataError: the file cannot be read, or has no such structure.
    """
    found = _variable(path, name, "structure")
    if isinstance(found, np.ndarray):
        raise DataError(f"{path}: {name}: found a matrix, expected a structure")
    return found


def _variable(path: Path, name: str, kind: str) -> Matrix | dict[str, Matrix]:
    try:
        data = memoryview(path.read_bytes())
        order = _order(data)
        names = []
        for code, content in _elements(data[HEADER:], order):
            if code not in (MATRIX, COMPRESSED):
                continue
            packed, head = code == COMPRESSED, content
            if packed:  # the tag of what is packed comes before it
                head = memoryview(zlib.decompressobj().decompress(content, HEAD))[8:]
            names.append(_head(head, order)[2])
            if names[-1] == name:
                found = _value(_unpacked(content, order) if packed else content, order)
                if found is None:
                    raise ValueError(f"{name} is no {kind} of real numbers")
                return found
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, ValueError, struct.error, zlib.error) as error:
        raise DataError(f"{path}: cannot be read as a MATLAB file: {error}") from error
    raise DataError(f"{path}: {unknown(kind, name, names)}")


def _order(data: memoryview) -> Order:
    """The order of bytes, from the file's header."""
    if bytes(data[:8]) != b"MATLAB 5" and bytes(data[126:128]) not in (b"IM", b"MI"):
        raise ValueError("it begins otherwise than MATLAB's files of version 5 to 7")
    order = "<" if bytes(data[126:128]) == b"IM" else ">"
    version = struct.unpack_from(f"{order}H", data, 124)[0]
    if version != 0x100:
        raise ValueError(
            f"found version {version:#x}, expected 0x100 (save(..., '-v7') writes it)"
        )
    return order


def _elements(data: memoryview, order: Order) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element, one after the other."""
    at = 0
    while at < len(data):
        code, size = struct.unpack_from(f"{order}II", data, at)
        begin, step = at + 8, at + 8 + (size if code == COMPRESSED else -(-size // 8) * 8)
        if code >> 16:  # up to four bytes stand within the tag
            code, size, begin, step = code & 0xFFFF, code >> 16, at + 4, at + 8
            if size > 4:
                raise ValueError(f"found {size} bytes within a tag, expected at most 4")
        if begin + size > len(data):
            raise ValueError(
                f"found an element of {size} bytes, but {len(data) - begin} remain"
            )
        yield code, data[begin : begin + size]
        at = step


def _unpacked(content: memoryview, order: Order) -> memoryview:
    """What a packed element holds, as far as its own tag and its checksum agree with it."""
    stream = zlib.decompressobj()
    code, size = struct.unpack(f"{order}II", stream.decompress(content, 8))
    if code != MATRIX or size > min(DEFLATED * len(content), MOST_BYTES):
        raise ValueError(f"found {size} bytes of type {code} packed into {len(content)}")
    data = stream.decompress(stream.unconsumed_tail, size + 8)
    if not stream.eof:
        data += stream.decompress(stream.unconsumed_tail, 8)
    if len(data) < size or not stream.eof:
        raise ValueError(f"found {len(data)} bytes packed, expected {size} and their end")
    return memoryview(data)[:size]


def _head(
    data: memoryview, order: Order
) -> tuple[int, tuple[int, ...], str, Iterator[tuple[int, memoryview]]]:
    """Flags, shape and name of an array, and its elements after these."""
    elements = _elements(data, order)
    try:
        (_, flags), (_, shape), (_, name) = next(elements), next(elements), next(elements)
    except StopIteration:
        raise ValueError("found an array that ends in its header") from None
    sizes = struct.unpack(f"{order}{len(shape) // 4}i", shape)
    if min(sizes, default=-1) < 0 or len(sizes) > 32:
        raise ValueError(f"found the shape {sizes[:33]}, expected sizes from 0")
    return struct.unpack_from(f"{order}I", flags)[0], sizes, bytes(name).decode(), elements


def _value(
    data: memoryview, order: Order, whole: bool = True
) -> Matrix | dict[str, Matrix] | None:
    """A matrix; with ``whole`` a structure, too; None for anything else, such as text."""
    flags, shape, _, elements = _head(data, order)
    if flags & 0xFF in NUMERIC and not flags & COMPLEX:
        code, content = next(elements, (0, data[:0]))
        dtype = np.dtype(STORED.get(code, "V1")).newbyteorder(order)
        if code not in STORED or len(content) != math.prod(shape) * dtype.itemsize:
            raise ValueError(
                f"found {len(content)} bytes of type {code} for a matrix of the shape {shape}"
            )
        return np.frombuffer(content, dtype).astype(float).reshape(shape, order="F")
    if flags & 0xFF != STRUCTURE or not whole:
        return None
    (_, width), (_, text) = next(elements, (0, data[:0])), next(elements, (0, data[:0]))
    step = struct.unpack_from(f"{order}i", width)[0]
    if math.prod(shape) != 1 or step < 1:
        return None
    fields = {}
    for begin, (code, content) in zip(range(0, len(text), step), elements, strict=True):
        name = bytes(text[begin : begin + step]).partition(b"\0")[0].decode()
        value = _value(content, order, whole=False) if code == MATRIX and content else None
        if isinstance(value, np.ndarray):
            fields[name] = value
    return fields
