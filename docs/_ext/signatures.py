"""Signatures as the sources have them: ``at: Position``, not what the alias stands for."""

import ast
import dataclasses
import functools
import inspect
import sys
import textwrap
from typing import Any


def signature(member: Any) -> str:
    """What stands behind the name of a function or class where it is defined."""
    if not inspect.isclass(member):
        return _function(member)
    if dataclasses.is_dataclass(member):
        return _fields(member, [f.name for f in dataclasses.fields(member) if f.init])
    return _fields(member, getattr(member, "_fields", []))


def _function(member: Any) -> str:
    source = textwrap.dedent(inspect.getsource(inspect.unwrap(member)))
    node = ast.parse(source).body[0]
    assert isinstance(node, ast.FunctionDef)
    if node.args.args and node.args.args[0].arg in {"self", "cls"}:
        del node.args.args[0]
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"({ast.unparse(node.args)}){returns}"


def _fields(cls: type, names: Any) -> str:
    declared: dict[str, str] = {}
    for owner in reversed(cls.__mro__):
        if owner.__module__.startswith("kedge"):
            declared |= _annotated(owner.__module__, owner.__qualname__)
    return f"({', '.join(declared.get(name, name) for name in names)})"


def _annotated(module: str, qualname: str) -> dict[str, str]:
    """Field to its declaration, ``std: Metres = 1.0``."""
    node = _classes(module).get(qualname)
    return {
        each.target.id: ast.unparse(_plain(each))
        for each in (node.body if node else [])
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)
    }


def _plain(node: ast.AnnAssign) -> ast.AnnAssign:
    """``eqx.field(static=True, default=8)`` is 8 to whoever calls."""
    if isinstance(node.value, ast.Call) and ast.unparse(node.value.func).endswith("field"):
        node.value = {key.arg: key.value for key in node.value.keywords}.get("default")
    return node


@functools.cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
