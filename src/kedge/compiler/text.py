"""Words of LLVM's assembly language: types, constants, instructions of one node."""

import struct
from typing import Any

from kedge.compiler.graph import FLOATS, Node, Unsupported

LLVM_TYPES = {
    "f8": "double", "f4": "float", "i8": "i64", "i4": "i32", "i2": "i16", "i1": "i8",
    "u8": "i64", "u4": "i32", "u2": "i16", "u1": "i8", "b1": "i1",
}  # fmt: skip
FLOAT_OPS = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
INTEGER_OPS = {
    "add": "add", "sub": "sub", "mul": "mul", "and": "and", "or": "or", "xor": "xor",
    "shift_left": "shl", "shift_unsigned": "lshr", "shift_signed": "ashr",
}  # fmt: skip
INTRINSICS = {
    "fma": "fma", "abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil",
    "trunc": "trunc", "even": "rint", "copysign": "copysign",
}  # fmt: skip
FLOAT_TESTS = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}


def type_of(kind: str, lanes: int) -> str:
    """LLVM's name of a number of that kind, or of one for each of several runs."""
    return LLVM_TYPES[kind] if lanes == 1 else f"<{lanes} x {LLVM_TYPES[kind]}>"


def constant(value: Any, kind: str, lanes: int) -> str:
    """A known number."""
    if kind in FLOATS:
        number = float(value)
        if kind == "f4":
            number = struct.unpack("<f", struct.pack("<f", number))[0]
        one = f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"
    elif kind == "b1":
        one = "true" if value else "false"
    else:
        one = str(int(value))
    if lanes == 1:
        return one
    return "<" + ", ".join([f"{LLVM_TYPES[kind]} {one}"] * lanes) + ">"


def suffix(kind: str, lanes: int) -> str:
    """How an intrinsic says the type it is for."""
    one = {"f8": "f64", "f4": "f32"}.get(kind) or LLVM_TYPES[kind]
    return one if lanes == 1 else f"v{lanes}{one}"


def simple(node: Node, args: list[str], lanes: int) -> tuple[str, str | None]:
    """The instruction of a node, and the declaration that it needs.

    ``args`` are the names of its arguments, in the node's own number of lanes.

    Raises:
        Unsupported: there is none.
    """
    op, kind = node.op, node.kind
    form = type_of(kind, lanes)
    if kind in FLOATS and op in FLOAT_OPS:
        return f"{FLOAT_OPS[op]} contract {form} {args[0]}, {args[1]}", None
    if kind in FLOATS and op == "neg":
        return f"fneg {form} {args[0]}", None
    if kind in FLOATS and op in INTRINSICS:
        name = f"@llvm.{INTRINSICS[op]}.{suffix(kind, lanes)}"
        shown = ", ".join(f"{form} {arg}" for arg in args)
        types = ", ".join([form] * len(args))
        return f"call {form} {name}({shown})", f"declare {form} {name}({types})"
    if op in INTEGER_OPS:
        return f"{INTEGER_OPS[op]} {form} {args[0]}, {args[1]}", None
    if op in ("quotient", "remainder"):
        sign, word = "s" if kind[0] == "i" else "u", "div" if op == "quotient" else "rem"
        return f"{sign}{word} {form} {args[0]}, {args[1]}", None
    if op == "neg":
        return f"sub {form} {constant(0, kind, lanes)}, {args[0]}", None
    if op == "not":
        ones = constant(1 if kind == "b1" else -1, kind, lanes)
        return f"xor {form} {args[0]}, {ones}", None
    if op in FLOAT_TESTS:
        return _test(node, args, lanes), None
    if op == "bitcast":
        before = type_of(node.args[0].kind, lanes)
        return f"bitcast {before} {args[0]} to {form}", None
    if op == "convert":
        return _conversion(node, args[0], lanes)
    raise Unsupported(f"operation {op!r} of {kind}")


def _test(node: Node, args: list[str], lanes: int) -> str:
    kind = node.args[0].kind
    before = type_of(kind, lanes)
    if kind in FLOATS:
        return f"fcmp {FLOAT_TESTS[node.op]} {before} {args[0]}, {args[1]}"
    sign = "" if node.op in ("eq", "ne") else "s" if kind[0] == "i" else "u"
    return f"icmp {sign}{node.op} {before} {args[0]}, {args[1]}"


def _conversion(node: Node, arg: str, lanes: int) -> tuple[str, str | None]:
    before, after = node.args[0].kind, node.kind
    old, new = type_of(before, lanes), type_of(after, lanes)
    if before in FLOATS and after in FLOATS:
        word = "fpext" if after == "f8" else "fptrunc"
    elif before in FLOATS:
        word = "fptosi" if after[0] == "i" else "fptoui"
        name = f"@llvm.{word}.sat.{suffix(after, lanes)}.{suffix(before, lanes)}"
        return f"call {new} {name}({old} {arg})", f"declare {new} {name}({old})"
    elif after in FLOATS:
        word = "sitofp" if before[0] == "i" else "uitofp"
    else:
        wide, narrow = (1 if k == "b1" else 8 * int(k[1:]) for k in (after, before))
        if wide == narrow:
            return f"bitcast {old} {arg} to {new}", None
        word = "trunc" if wide < narrow else "sext" if before[0] == "i" else "zext"
    return f"{word} {old} {arg} to {new}", None
