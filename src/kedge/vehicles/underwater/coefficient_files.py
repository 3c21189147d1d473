"""Coefficients of hulls from files: those that come with kedge, and one's own."""

import functools as ft
import math
import tomllib
import warnings
from dataclasses import fields
from importlib import resources
from pathlib import Path
from typing import Any

import tomli_w

from kedge.core.errors import ConfigError, ContractError, UnknownName
from kedge.core.registry import unknown
from kedge.vehicles.underwater.hydrodynamics import GRAVITY, Coefficients

TEXTS = ("title", "source")


def shipped_coefficients() -> list[str]:
    """The names of the sets that come with kedge."""
    files = (resources.files("kedge.vehicles.underwater") / "coefficients").iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


def as_coefficients(given: Coefficients | str) -> Coefficients:
    """Coefficients as they are, by the name of a shipped set, or from a TOML file by path.

    A file gives every coefficient once, in tables of any name, as those that come with kedge.
    Some can be changed after a colon: ``remus100-adjusted:buoyancy=299,Yvv=-131``.

    Raises:
        UnknownName: no set of that name comes with kedge.
        ConfigError: the file is missing or wrong, or a change is; one line for each mistake.
    """
    if not isinstance(given, str):
        return given
    whole, _, changes = given.partition(":")
    if changes:
        return _changed(given, as_coefficients(whole), changes)
    path = Path(given)
    if path.suffix == ".toml" or len(path.parts) > 1:
        return _read(given, path)
    if given not in (known := shipped_coefficients()):
        raise UnknownName(unknown("coefficients", given, known))
    return _shipped(given)


def as_toml(hull: Coefficients, title: str, source: str) -> str:
    """The text of a coefficient file, to be edited and used by its path."""
    groups = {"drive": ["Xprop", "Kprop", "fin_limit"]}
    names = [name for name in hull.values() if name not in groups["drive"]]
    axes = {"surge": "X", "sway": "Y", "heave": "Z", "roll": "K", "pitch": "M", "yaw": "N"}
    groups["body"] = [name for name in names if name[0] not in "XYZKMN"]
    groups |= {axis: [n for n in names if n[0] == letter] for axis, letter in axes.items()}
    tables = {
        group: {name: float(f"{float(getattr(hull, name)):.6g}") for name in members}
        for group, members in groups.items()
    }
    return tomli_w.dumps({"title": title, "source": source, **tables})


@ft.cache
def _shipped(name: str) -> Coefficients:
    place = resources.files("kedge.vehicles.underwater") / "coefficients" / f"{name}.toml"
    with resources.as_file(place) as path:
        return _read(name, path)


def _changed(given: str, hull: Coefficients, changes: str) -> Coefficients:
    known, values = hull.values(), {}
    for change in changes.split(","):
        key, _, text = (part.strip() for part in change.partition("="))
        if key not in known:
            raise ConfigError(f"{given}: {unknown('coefficient', key, list(known))}")
        try:
            values[key] = float(text)
        except ValueError:
            values[key] = math.nan
        if not math.isfinite(values[key]):
            raise ConfigError(f"{given}: {key}: found {text!r}, expected a finite number")
    try:
        changed = hull.changed(**values)
    except ContractError as error:
        raise ConfigError(f"{given}: {error}") from error
    _warn_of_sinking(given, changed.values())
    return changed


def _read(name: str, path: Path) -> Coefficients:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{name}: is no TOML file: {error}") from error
    known = [field.name for field in fields(Coefficients)]
    values: dict[str, float] = {}
    wrong: list[str] = []
    for key, value in _entries(content):
        short = key.rpartition(".")[2]
        if short not in known:
            wrong.append(f"{key}: {unknown('coefficient', short, known)}")
        elif short in values:
            wrong.append(f"{key}: found twice, expected each coefficient once")
        elif type(value) not in (int, float) or not math.isfinite(value):
            wrong.append(f"{key}: found {value!r}, expected a finite number")
        values.setdefault(short, value)
    wrong += [f"{key}: this coefficient is missing" for key in known if key not in values]
    if wrong:
        raise ConfigError("\n".join(f"{name}: {line}" for line in wrong))
    try:
        hull = Coefficients(**{key: float(value) for key, value in values.items()})
    except ContractError as error:
        raise ConfigError(f"{name}: {error}") from error
    _warn_of_sinking(name, values)
    return hull


def _entries(content: dict[str, Any]) -> list[tuple[str, Any]]:
    entries = []
    for key, value in content.items():
        if isinstance(value, dict):
            entries += [(f"{key}.{short}", inner) for short, inner in value.items()]
        elif key not in TEXTS:
            entries.append((key, value))
    return entries


def _warn_of_sinking(name: str, values: dict[str, float]) -> None:
    weight, buoyancy = values["weight"], values["buoyancy"]
    if weight > buoyancy:
        heaving = weight / GRAVITY - values["Zwdot"]
        warnings.warn(
            f"{name}: weight {weight:g} N is above buoyancy {buoyancy:g} N: the vehicle sinks, "
            f"at first with {(weight - buoyancy) / heaving:.2g} m/s^2; fins hold it at speed "
            "only",
            stacklevel=4,
        )
