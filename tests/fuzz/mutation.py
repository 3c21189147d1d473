"""Seeded damage to files and to text, of the kinds that disks, editors and typing do."""

import random
import re
import struct

BYTES = (0, 1, 0x7F, 0x80, 0xFF)
SIZES = (0, -1, 2**31 - 1, -(2**31), 2**40, 2**62, 2**63 - 1)
VALUES = (
    "nan", "inf", "-inf", "0", "-1", "1e-320", "1e308", "1e999", "1e999999999", "-0.0", "1_0",
    "9" * 400, "9" * 5000, "true", '"x"', "''", "[]", "{}", "[[]]", "x", "", "#", "=", '"',
    "[" * 3000, "(" * 3000, "1979-05-27", "\x00", "é", "\ud7ff", "a" * 300, "../../etc/passwd",
)  # fmt: skip
TOKEN = re.compile(r"[\w.+-]+|\S")


def mutated_bytes(data: bytes, draw: random.Random) -> bytes:
    """One to three changes to a file."""
    found = bytearray(data)
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        _change(found, draw)
    return bytes(found)


def _change(data: bytearray, draw: random.Random) -> None:
    at = draw.randrange(len(data) + 1)
    length = draw.choice([1, 2, 8, 64, 512])
    match draw.randrange(8):
        case 0 | 1:
            data[at : at + 1] = bytes([draw.choice([*BYTES, draw.randrange(256)])])
        case 2:
            form = draw.choice(["<i", ">i", "<q", ">q"])
            size = draw.choice(SIZES)
            packed = struct.pack(
                form, size if form[1] == "q" else (size + 2**31) % 2**32 - 2**31
            )
            data[at : at + len(packed)] = packed
        case 3:
            del data[at:]
        case 4:
            del data[at : at + length]
        case 5:
            data[at:at] = data[at : at + length]
        case 6:
            data[at:at] = draw.randbytes(length)
        case 7:
            data[at : at + length] = bytes(len(data[at : at + length]))


def mutated_text(text: str, draw: random.Random) -> str:
    """One to three changes to a text: values, letters, lines."""
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        tokens = list(TOKEN.finditer(text))
        lines = text.splitlines(keepends=True)
        kind = draw.randrange(8)
        if kind < 4 and tokens:
            token = draw.choice(tokens)
            new = draw.choice([*VALUES, draw.choice(tokens)[0]])
            if kind == 3:  # a slip of the finger
                cut = draw.randrange(len(token[0]))
                new = token[0][:cut] + token[0][cut + 1 :]
            text = text[: token.start()] + new + text[token.end() :]
        elif lines:
            one, other = draw.randrange(len(lines)), draw.randrange(len(lines))
            if kind == 4:
                del lines[one]
            elif kind == 5:
                lines.insert(other, lines[one])
            elif kind == 6:
                lines[one], lines[other] = lines[other], lines[one]
            text = "".join(lines) if kind < 7 else text[: draw.randrange(len(text) + 1)]
    return text
