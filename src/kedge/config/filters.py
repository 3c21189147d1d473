"""Filters as they are typed: ``robust:loss=cauchy,inner=(particle:count=500)``."""

import ast
import dataclasses
import math
from typing import Any

from kedge.config.models import kinds_of
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ConfigError, ContractError
from kedge.core.registry import filters, unknown

MOST_DEPTH = 20
"""Filters in filters: more are a slip."""


def build_filter(spec: str) -> AbstractFilter:
    """A filter from ``NAME`` or ``NAME:PARAMETER=VALUE,...``.

    A value is a number, ``true`` or ``false``, a word, or another filter, as in
    ``gated:inner=unscented``; one with several parameters of its own stands in parentheses.

    Raises:
        UnknownName: there is no such filter.
        ConfigError: a parameter is unknown, of the wrong type or refused by the filter.
    """
    return _build(spec, spec if len(spec) <= 200 else f"{spec[:200]}...", MOST_DEPTH)


def split_top(text: str, separator: str = ",") -> list[str]:
    """Split at separators that stand outside parentheses."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == separator and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def split_names(names: str) -> list[str]:
    """Filters with commas between them; a comma inside parameters belongs to the filter.

    ``a:x=1,y=2,b`` is two filters: what contains ``=`` but no ``:`` before it goes on with the
    one before.
    """
    filters: list[str] = []
    for part in split_top(names):
        if filters and "=" in part and ":" not in part.partition("=")[0]:
            filters[-1] += f",{part}"
        else:
            filters.append(part.strip())
    return filters


def _build(spec: str, whole: str, depth: int) -> AbstractFilter:
    if not depth:
        raise ConfigError(
            f"filter {whole!r}: found filters in filters, expected at most {MOST_DEPTH}"
        )
    name, _, arguments = spec.partition(":")
    cls = filters.get(name.strip())
    known = parameters_of(cls)
    given: dict[str, Any] = {}
    for item in split_top(arguments) if arguments.strip() else ():
        key, equals, text = (part.strip() for part in item.partition("="))
        if not equals:
            raise ConfigError(f"filter {whole!r}: found {item!r}, expected PARAMETER=VALUE")
        if key not in known:
            raise ConfigError(
                f"filter {whole!r}: {unknown(f'parameter of {name}', key, list(known))}"
            )
        if key in given:
            raise ConfigError(f"filter {whole!r}: found {key!r} twice, expected it once")
        given[key] = _value(whole, key, text, known[key], depth)
    try:
        return cls(**given)
    except ContractError as error:
        raise ConfigError(f"filter {whole!r}: {error}") from error


def parameters_of(cls: type) -> dict[str, type]:
    """What can be typed for each parameter of a filter."""
    inner = {
        field.name: AbstractFilter
        for field in dataclasses.fields(cls)
        if isinstance(field.default, AbstractFilter)
    }
    return inner | kinds_of(cls)


def _value(spec: str, key: str, text: str, kind: type, depth: int) -> Any:
    if kind is AbstractFilter:
        inside = text[1:-1] if text.startswith("(") and text.endswith(")") else text
        return _build(inside, spec, depth - 1)
    if kind in (str, tuple) and text:  # a list is read from its text by who has it
        return text
    if kind is bool and text in ("true", "false"):
        return text == "true"
    if kind in (int, float):
        try:
            value = math.inf if text == "inf" else ast.literal_eval(text)
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            value = None
        if type(value) is int and abs(value) < 2**63:
            return kind(value)
        if type(value) is float and kind is float:
            return value
    expected = {bool: "true or false", int: "a whole number", float: "a number"}
    expected |= {str: "a word", tuple: "a list"}
    raise ConfigError(f"filter {spec!r}: {key}: found {text[:60]!r}, expected {expected[kind]}")
