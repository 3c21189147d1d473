"""Public names: listed once, in a package's stub, and imported when they are first asked for.

The stub ``__init__.pyi`` beside a package's ``__init__.py`` is what editors and type checkers
read; here it is read once more, so that there is no second list. Its lines are of the form
``from kedge.core.beliefs import Gaussian as Gaussian``. Nothing is imported before it is used:
the command line answers ``--help`` without JAX.
"""

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kedge.core.errors import UnknownName
from kedge.core.registry import Registry, camel_case


def attach(
    package: str, file: str, *families: Registry
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package with a stub.

    A name that the stub does not list is looked for in ``families``: members that somebody
    else registered are there by the names of the registry, ``my-robot`` as ``MyRobot``.
    """
    listed = names_in(Path(file).with_suffix(".pyi"))

    def get(name: str) -> Any:
        if name in listed:
            module, attribute = listed[name]
            if module == package:
                value = importlib.import_module(f"{package}.{attribute}")
            else:
                value = getattr(importlib.import_module(module), attribute)
        else:
            value = _registered(package, name, families)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        members = (camel_case(name) for family in families for name in family.names())
        return sorted({*vars(sys.modules[package]), *listed, *members})

    return get, names, sorted(listed)


def names_in(stub: Path) -> dict[str, tuple[str, str]]:
    """Public name -> module and name there, as a stub's imports have them."""
    return {
        alias.asname or alias.name: (node.module or "", alias.name)
        for node in ast.parse(stub.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname
    }


def _registered(package: str, name: str, families: tuple[Registry, ...]) -> Any:
    if name[:1].isupper():
        for family in families:
            try:
                return family.by_class_name(name)
            except UnknownName:
                continue
    raise AttributeError(f"module {package!r} has no attribute {name!r}")
