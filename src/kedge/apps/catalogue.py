"""What ``kedge list`` shows."""

import sys
from importlib.resources import files
from typing import Any

from kedge.apps.console import printer
from kedge.core.errors import UnknownName
from kedge.core.registry import readers, unknown

CLASSES = ("vehicles", "sensors", "filters", "worlds", "routes", "faults")
FAMILIES = (*CLASSES, "rigs", "scenarios", "datasets", "readers")


def catalogue(what: str = "all") -> dict[str, dict[str, Any]]:
    """One family, or all of them, by name.

    Raises:
        UnknownName: there is no such family.
    """
    if what not in (*FAMILIES, "all"):
        raise UnknownName(unknown("families", what, [*FAMILIES, "all"]))
    chosen = FAMILIES if what == "all" else (what,)
    families: dict[str, dict[str, Any]] = {}
    if classes := [family for family in chosen if family in CLASSES]:
        from kedge.apps.describe import registered

        families |= {family: registered(family) for family in classes}
    if "rigs" in chosen:
        families["rigs"] = _titles("rigs")
    if "scenarios" in chosen:
        families["scenarios"] = _titles("scenarios")
    if "datasets" in chosen:
        families["datasets"] = _datasets()
    if "readers" in chosen:
        families["readers"] = {
            name: {"summary": _first_line(readers.get(name))} for name in readers.names()
        }
    return {family: families[family] for family in chosen}


def print_catalogue(families: dict[str, dict[str, Any]]) -> None:
    """Names, what they are, and their parameters, for people."""
    console = printer(None)
    for family, table in families.items():
        console.print(f"[bold]{family}[/bold]")
        for name, about in table.items():
            console.print(f"  {name:20s}", style="cyan", end=" ")
            console.print(about["summary"], markup=False, soft_wrap=True)
            settings = [
                f"{key}={_plain(value['default'])} {value['unit']}".removesuffix(" 1").rstrip()
                for key, value in about.get("parameters", {}).items()
            ]
            if settings:
                _detail(console, ", ".join(settings))
            for key in ("state", "control", "reads", "reads_if_present", "measurement"):
                if about.get(key):
                    parts = ", ".join(f"{n} ({unit})" for n, unit in about[key].items())
                    _detail(console, f"{key.replace('_', ' ')}: {parts}")
        console.print()


def schema(of: str) -> dict[str, Any]:
    """The JSON schema of rig files ("rig"), of log.toml ("log"), or of summaries."""
    if of == "rig":
        from kedge.config.rigs import rig_schema

        return rig_schema()
    if of == "log":
        from kedge.formats.log_config import log_schema

        return log_schema()
    from kedge.apps.summaries import summary_schema

    return summary_schema()


def _detail(console: Any, text: str) -> None:
    console.print(f"  {'':20s} {text}", style="dim", markup=False, soft_wrap=True)


def _plain(value: Any) -> Any:
    if value is None:
        return "none"
    return value if isinstance(value, (int, float, str)) else "[...]"


def _titles(kind: str) -> dict[str, Any]:
    import tomllib

    folder, titles = files("kedge") / kind, {}
    for name in sorted(p.name for p in folder.iterdir() if p.name.endswith(".toml")):
        tree = tomllib.loads((folder / name).read_text())
        title = tree.get("scenario", tree).get("title", "")
        titles[name.removesuffix(".toml")] = {"summary": title}
    return titles


def _datasets() -> dict[str, Any]:
    """Recorded sets: those that have a reader of their own, and those that can be fetched."""
    from kedge.datasets.fetch import DATASETS, locate

    formats = "kedge.formats."
    recorded = [n for n in readers.names() if not readers.get(n).__module__.startswith(formats)]
    entries: dict[str, dict[str, Any]] = {
        name: {"summary": _module_title(readers.get(name))} for name in recorded
    }
    for name, entry in DATASETS.items():
        place = locate(name)
        entries[name] = {
            "summary": f"{entry.title}: {place or 'not here; kedge datasets fetch ' + name}",
            "path": str(place) if place else None,
            "url": entry.url,
            "cite": entry.cite,
        }
    return dict(sorted(entries.items()))


def _module_title(reader: Any) -> str:
    """The first sentence of the file that a reader stands in, which says what was recorded."""
    return _first_line(sys.modules[reader.__module__])


def _first_line(documented: Any) -> str:
    return (documented.__doc__ or "").strip().partition("\n")[0]
