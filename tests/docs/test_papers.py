"""The table of the papers' claims, from summaries of studies."""

import json
import sys
from pathlib import Path

import pytest

EXAMPLES = str(Path(__file__).parents[2] / "examples")


def summary(folder, scenario, **changes):
    claim = {"text": "Pipes | are", "source": "p. 1", "test": "a.nees < 1", "means": "So."}
    judged = {"verdict": "true", "figures": "a nees 0.5"}
    study = {
        "arguments": ["study", scenario, "--out", str(folder), "--force", "--runs", "4"],
        "title": f"The {scenario}",
        "runs": 4,
        "claims": [claim | judged],
        "quoted": [{"score": "a.nees", "value": 0.25, "source": "Table 1", "here": None}],
    }
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(study | changes))
    return str(folder)


def test_each_study_stands_under_its_paper(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(EXAMPLES)
    import papers

    untested = {"text": "Unclear", "source": "p. 2", "test": "", "means": "Of what?"}
    untested |= {"verdict": "not decided by these runs", "figures": "this study does not"}
    folders = [
        summary(tmp_path / "b", "omni-circle", claims=[untested]),
        summary(tmp_path / "a", "agv-corners"),
    ]
    monkeypatch.setattr(sys, "argv", ["papers.py", *folders])
    papers.main()
    lines = capsys.readouterr().out.splitlines()
    heads = [line for line in lines if line.startswith("##")]
    assert [head.split()[:3] for head in heads] == [
        ["##", "K.", "Oktafianto"], ["###", "The", "agv-corners"],
        ["##", "R.", "Dixon,"], ["###", "The", "omni-circle"],
    ]  # fmt: skip
    assert "`kedge study agv-corners --runs 4` (4 runs)" in lines
    assert "| Pipes / are | p. 1 | true | a nees 0.5 | So. |" in lines
    assert "| Unclear | p. 2 | not tested | – | Of what? |" in lines
    assert "| `a.nees` | 0.25 | – | Table 1 |" in lines


def test_a_folder_without_results_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(EXAMPLES)
    import papers

    monkeypatch.setattr(sys, "argv", ["papers.py", str(tmp_path)])
    with pytest.raises(SystemExit, match="2"):
        papers.main()
    assert "summary.json: there is no such file" in capsys.readouterr().err
