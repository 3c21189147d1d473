"""The table of all recorded runs: a short piece of it, with what marks a figure."""

import sys
from pathlib import Path

EXAMPLES = str(Path(__file__).parents[2] / "examples")


def test_a_rig_that_claims_too_much_is_marked(data, monkeypatch, capsys):
    monkeypatch.syspath_prepend(EXAMPLES)
    import honesty

    arguments = ["honesty.py", "hanyang", "--until", "20"]
    claims = ["--set", "sensors.radio.parameters.range_std=0.002"]
    claims += ["--set", "sensors.radio.error={ std = 0.001, time_constant = 1.0 }"]
    tables = []
    for more in ([], claims):
        monkeypatch.setattr(sys, "argv", arguments + more)
        honesty.main()
        rows = capsys.readouterr().out.splitlines()[2:]
        assert len(rows) == 8
        tables.append([[cell.strip() for cell in row.split("|")[1:-1]] for row in rows])
    for row, sure in zip(*tables, strict=True):
        assert row[:4] == sure[:4]
        assert float(sure[6].rstrip(" *")) > float(row[6].rstrip(" *"))
        assert sure[6].endswith("*")
        assert sure[5].endswith("*")
