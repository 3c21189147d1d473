"""The page on a package of one's own, followed to the letter but for ``pip install``."""

import importlib
import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from kedge.core import registry

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "plug-in.md"
FILE = re.compile(r"^`([\w./]+)`:\n\n```\w+\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^\$ kedge (.*)$", re.MULTILINE)
FAMILIES = ("vehicles", "sensors")


@pytest.fixture
def orchard(tmp_path, monkeypatch):
    """The page's files are on disk, and what ``pip install`` would register is."""
    for family in FAMILIES:
        members = getattr(registry, family)
        members.names()
        monkeypatch.setattr(members, "_members", dict(members._members))
        monkeypatch.setattr(members, "_complete", False)
    for name, text in FILE.findall(PAGE.read_text()):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    project = tomllib.loads((tmp_path / "orchard" / "pyproject.toml").read_text())["project"]
    metadata = tmp_path / "orchard" / "orchard-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: orchard\nVersion: 1.0\n")
    points = ""
    for group, entries in project["entry-points"].items():
        points += f"[{group}]\n" + "".join(f"{key} = {at}\n" for key, at in entries.items())
    (metadata / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(tmp_path / "orchard")
    importlib.invalidate_caches()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_page_works_as_it_stands(orchard, kedge):
    text = PAGE.read_text()
    program = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[-1]
    *before, estimate = COMMAND.findall(text)
    shown = ""
    for command in before:
        code, out, err = kedge(*shlex.split(command))
        assert code == 0, err
        shown += out
    assert "sprayer" in shown
    scores = [
        json.loads((orchard / name / "summary.json").read_text())["filters"]
        for name in ("whole", "merged")
    ]
    assert scores[0]["extended"]["score"] == pytest.approx(scores[1]["extended"]["score"])
    exec(compile(program, str(PAGE), "exec"), {"__name__": "page"})
    code, _, err = kedge(*shlex.split(estimate))
    assert code == 0, err
    result = json.loads((orchard / "result" / "summary.json").read_text())
    assert result["filters"]["extended"]["rmse"]["position"] < 1.0
