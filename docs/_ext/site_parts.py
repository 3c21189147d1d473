"""What the site adds to Sphinx: public names, registries, formulas that need no script."""

import importlib
import inspect
import re
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from latex2mathml.converter import convert
from signatures import signature
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring

from kedge.apps.describe import registered
from kedge.core import registry
from kedge.core.registry import Registry, camel_case

MATH = re.compile(r"(?<!\\)\$([^$]+)\$")
FAMILIES = ("vehicles", "sensors", "filters", "worlds", "routes", "faults")


def room_of(family: str) -> str:
    """The package whose public names a family's classes are."""
    return f"kedge.{family}" if family in FAMILIES[:3] else "kedge.simulation"


def prose(member: Any) -> list[str]:
    """A docstring as reStructuredText: Google's sections, and formulas between dollars."""
    text = inspect.cleandoc(member.__doc__ or "")
    text = MATH.sub(lambda found: f":math:`{' '.join(found.group(1).split())}`", text)
    # A role has to stand apart from a word that it is part of.
    text = re.sub(r"(?<=[\w)])(:math:`)", r"\\ \1", text)
    text = re.sub(r"(:math:`[^`]+`)(?=[\w(])", r"\1\\ ", text)
    text = re.sub(r"^Source: ", "*Source:* ", text, flags=re.MULTILINE)
    return GoogleDocstring(text, Config(napoleon_use_rtype=False)).lines()


def indented(lines: list[str]) -> list[str]:
    """Lines as the body of a directive."""
    return ["", *(f"   {line}".rstrip() for line in lines), ""]


def described(name: str, member: Any, body: list[str]) -> list[str]:
    """A class or function as an entry of the reference, with its methods and properties."""
    public = name.rpartition(".")[2]
    if not inspect.isclass(member) and not inspect.isroutine(member):
        return [f".. py:data:: {public}", ""]
    kind = "class" if inspect.isclass(member) else "function"
    lines = [f".. py:{kind}:: {public}{signature(member)}"]
    path = f"{member.__module__}.{getattr(member, '__qualname__', '')}"
    if path != name and (kind == "class" or inspect.isfunction(member)):
        lines += [f"   :canonical: {path}"]
    lines += indented(body)
    if kind == "class":
        for method, value in vars(member).items():
            if not method.startswith("_") and getattr(value, "__doc__", None):
                lines += indented(_part(method, value))
    return lines


def _part(name: str, value: Any) -> list[str]:
    if isinstance(value, property):
        return [f".. py:property:: {name}", *indented(prose(value))]
    method = getattr(value, "__func__", value)
    if not inspect.isfunction(inspect.unwrap(method)):
        return []
    return [f".. py:method:: {name}{signature(method)}", *indented(prose(method))]


class Page(Directive):
    """A directive that writes reStructuredText with headings, about one name."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        section = nodes.section()
        section.document = self.state.document
        name = self.arguments[0]
        room = name if name.startswith("kedge") else room_of(name)
        lines = [f".. py:currentmodule:: {room}", "", *self.lines(name)]
        text = StringList(lines, source="kedge")
        self.state.nested_parse(text, 0, section, match_titles=True)
        return section.children

    def lines(self, name: str) -> list[str]:
        """The text."""
        raise NotImplementedError


class Members(Page):
    """``.. members:: vehicles``: each registered one with its parameters and their units."""

    def lines(self, name: str) -> list[str]:
        family, lines = getattr(registry, name), []
        for key, about in registered(name).items():
            cls = family.get(key)
            body = [*prose(cls), ""]
            for group, components in [*about.items()][2:]:
                if components:
                    body += [f":{group.replace('_', ' ')}: {with_units(components)}"]
            body += ["", *table(about["parameters"])]
            lines += ["", key, "-" * len(key), ""]
            lines += described(f"{room_of(name)}.{camel_case(key)}", cls, body)
        return lines


class Public(Page):
    """``.. public:: kedge.positioning``: its public names that no registry has."""

    def lines(self, name: str) -> list[str]:
        package, lines = importlib.import_module(name), []
        classes = {id(family.get(key)) for family in families() for key in family.names()}
        top = {id(getattr(importlib.import_module("kedge"), each)) for each in kedge_names()}
        for public in package.__all__:
            member = getattr(package, public)
            if inspect.ismodule(member) or isinstance(member, str) or id(member) in classes:
                continue
            if name == "kedge" or id(member) not in top:
                lines += described(f"{name}.{public}", member, prose(member))
        return lines


def families() -> list[Registry]:
    """All registries that have a page."""
    return [getattr(registry, name) for name in FAMILIES]


def kedge_names() -> list[str]:
    """What ``kedge`` itself exports."""
    return importlib.import_module("kedge").__all__


def with_units(components: dict[str, str]) -> str:
    """``position_x`` (m), ...; the middle of a long list is left out."""
    shown = [f"``{name}`` ({unit})" for name, unit in components.items()]
    return ", ".join(shown if len(shown) < 16 else [*shown[:2], "…", shown[-1]])


def table(parameters: dict[str, dict[str, Any]]) -> list[str]:
    """Parameters with default and unit."""
    if not parameters:
        return []
    rows = [["parameter", "default", "unit"]]
    for name, about in parameters.items():
        default = " ".join(str(about["default"]).split())
        rows.append([f"``{name}``", f"``{default}``" if default else "", about["unit"]])
    lines = [
        f"   {mark} - {cell}" for row in rows for mark, cell in zip("*  ", row, strict=True)
    ]
    return [".. list-table::", "   :header-rows: 1", "   :widths: auto", "", *lines, ""]


def formula(visitor: Any, node: nodes.Element) -> None:
    """A formula as MathML, which browsers draw themselves."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    mathml = convert(node.astext(), display=display)
    visitor.body.append(f"<div>{mathml}</div>" if display == "block" else mathml)
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.add_directive("members", Members)
    app.add_directive("public", Public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
