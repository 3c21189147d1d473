"""The code in the documents runs as it stands."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_code_blocks_run(document, monkeypatch, tmp_path, capsys):
    blocks = BLOCK.findall(document.read_text())
    if not blocks:
        pytest.skip("no code in it")
    monkeypatch.chdir(tmp_path)
    source = "\n".join(blocks)
    names = {"__name__": f"document_{document.stem.replace('-', '_')}"}
    module = type(pytest)(names["__name__"])
    monkeypatch.setitem(__import__("sys").modules, names["__name__"], module)
    exec(compile(source, str(document), "exec"), module.__dict__)
