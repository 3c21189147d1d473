"""The code in the documents runs as it stands."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(
    r"^```(?:python|\{code-cell\} ipython3)\n(.*?)^```", re.MULTILINE | re.DOTALL
)
DOCUMENTS = [
    path.relative_to(ROOT)
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if BLOCK.search(path.read_text()) and path.name != "plug-in.md"  # it has a test of its own
]
# What a newcomer reads first is always tried.
FIRST = {Path("README.md"), Path("docs/how-to/add-a-vehicle.md")}


@pytest.mark.parametrize(
    "document",
    [d if d in FIRST else pytest.param(d, marks=pytest.mark.slow) for d in DOCUMENTS],
    ids=str,
)
def test_code_blocks_run(document, monkeypatch, tmp_path, capsys):
    document = ROOT / document
    blocks = BLOCK.findall(document.read_text())
    monkeypatch.chdir(tmp_path)
    source = "\n".join(blocks)
    names = {"__name__": f"document_{document.stem.replace('-', '_')}"}
    module = type(pytest)(names["__name__"])
    monkeypatch.setitem(__import__("sys").modules, names["__name__"], module)
    exec(compile(source, str(document), "exec"), module.__dict__)
