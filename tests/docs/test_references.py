"""Every source that a docstring names stands in docs/references.bib, and nothing else does."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = re.compile(r"Source: (.*?)(?=\n\s*\n|\"\"\")", re.DOTALL)


def bibliography() -> dict[str, str]:
    """Title by key."""
    text = (ROOT / "docs" / "references.bib").read_text()
    entries = re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", text, re.MULTILINE | re.DOTALL)
    return {key: re.findall(r"^  title = \{\{(.*)\}\}", body, re.M)[0] for key, body in entries}


def cited() -> dict[str, Path]:
    """Titles in the sources of docstrings, and where."""
    found = {}
    for path in sorted((ROOT / "src").rglob("*.py")):
        for source in SOURCE.findall(path.read_text()):
            for title in re.findall(r'"([^"]+)"', " ".join(source.split())):
                found[title.rstrip(",")] = path.relative_to(ROOT)
    return found


def test_each_key_stands_once():
    keys = re.findall(r"^@\w+\{(\w+),", (ROOT / "docs" / "references.bib").read_text(), re.M)
    assert sorted(set(keys)) == keys


def test_what_is_cited_is_listed_and_what_is_listed_is_cited():
    titles, named = set(bibliography().values()), cited()
    missing = {title: str(path) for title, path in named.items() if title not in titles}
    # A chapter names its book, which needs no entry of its own.
    books = {"Sequential Monte Carlo Methods in Practice"}
    assert {title for title in missing if title not in books} == set(), missing
    assert titles - set(named) == set()
