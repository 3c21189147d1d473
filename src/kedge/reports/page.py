"""A page of figures and tables that reads without a network: what all reports share."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from kedge.reports import style

TEMPLATES = Path(__file__).parent / "templates"


class Plate(NamedTuple):
    """A figure of the report with its caption."""

    name: str
    section: str
    caption: str
    figure: Any
    folded: bool = False


class Front(NamedTuple):
    """The head of a page: what it is about, and the result in a sentence."""

    kicker: str
    title: str
    headline: str
    strip: list[tuple[str, str]]
    """Name and value."""
    warnings: list[str]


def require_studio() -> None:
    """Look for what a page is made with, before anything is written.

    Raises:
        KedgeError: matplotlib or jinja2 is not installed.
    """
    for module in ("matplotlib", "jinja2"):
        style.studio(module)


def write_page(
    folder: Path, template: str, front: Front, plates: Iterable[Plate], **context: Any
) -> Path:
    """Write ``report.html`` and ``figures/*.svg`` and ``*.png``; return the page's path.

    The template finds the plates in ``figures``, by section, with their pictures as ``svg``.
    Its filter ``breakable`` lets long names of filters and scores break after their parts.
    The same content gives the same bytes.

    Raises:
        KedgeError: matplotlib or jinja2 is not installed.
    """
    require_studio()
    jinja2, markup = style.studio("jinja2"), style.studio("markupsafe").Markup
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    drawn: dict[str, list[dict[str, Any]]] = {}
    for plate in plates:
        svg = style.svg_of(plate.figure)
        (folder / "figures" / f"{plate.name}.svg").write_text(svg, encoding="utf-8")
        style.save_png(plate.figure, folder / "figures" / f"{plate.name}.png")
        picture = markup(style.inlined(svg, plate.name))
        drawn.setdefault(plate.section, []).append({**plate._asdict(), "svg": picture})
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = lambda name: markup(
        re.sub(r"([,:]|\.(?!\d))", r"\1<wbr>", str(markup.escape(name)))
    )
    page = environment.get_template(template).render(
        front=front, palette=style.PALETTE, figures=drawn, **context
    )
    path = folder / "report.html"
    # The name of a folder that this locale cannot read keeps its bytes.
    path.write_bytes(page.encode("utf-8", "surrogateescape"))
    return path
