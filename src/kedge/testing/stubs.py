"""The stubs of rooms with registered members: ``python -m kedge.testing.stubs`` writes them.

A stub lists what editors and type checkers offer. The lines of shipped members follow from the
registries; a line by hand, for something that is not registered, is kept.
"""

import importlib
from pathlib import Path

from kedge.core import registry
from kedge.core.lazy import names_in
from kedge.core.registry import Registry, camel_case

ROOMS: dict[str, tuple[Registry, ...]] = {
    "filters": (registry.filters,),
    "sensors": (registry.sensors,),
    "vehicles": (registry.vehicles,),
    "simulation": (registry.worlds, registry.routes, registry.faults),
}
WIDTH = 96


def stub_file(room: str) -> Path:
    """Where a room's stub is."""
    return Path(importlib.import_module(f"kedge.{room}").__file__ or "").with_suffix(".pyi")


def shipped(room: str) -> dict[str, tuple[str, str]]:
    """Public name -> module and class of the members that come with kedge."""
    members = [
        (camel_case(name), family.get(name))
        for family in ROOMS[room]
        for name in family.names()
    ]
    return {
        name: (cls.__module__, cls.__qualname__)
        for name, cls in members
        if cls.__module__.startswith("kedge.")
    }


def listed(room: str) -> dict[str, tuple[str, str]]:
    """What a room's stub should list: the shipped members, and what is there by hand."""
    members = shipped(room)
    by_hand = {
        name: (module, attribute)
        for name, (module, attribute) in names_in(stub_file(room)).items()
        if (module, attribute) not in members.values() and _leads_somewhere(module, attribute)
    }
    return members | by_hand


def text_of(names: dict[str, tuple[str, str]]) -> str:
    """The lines of a stub."""
    lines: list[str] = []
    for public, (module, attribute) in sorted(names.items(), key=lambda item: item[1]):
        line = f"from {module} import {attribute} as {public}"
        if len(line) > WIDTH:
            line = f"from {module} import (\n    {attribute} as {public},\n)"
        lines.append(line + "\n")
    # Without it, a name that is not what its class is called would be private to the stub.
    exported = [f'    "{name}",\n' for name in sorted(names)]
    return "".join([*lines, "\n__all__ = [\n", *exported, "]\n"])


def _leads_somewhere(module: str, attribute: str) -> bool:
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ImportError:
        return False


if __name__ == "__main__":
    for room in ROOMS:
        stub_file(room).write_text(text_of(listed(room)), encoding="utf-8")
