"""A rig on a log that it does not belong to: said before the figures."""

import json

import pytest


@pytest.mark.slow
def test_a_map_of_another_place_is_said_first(site, kedge):
    """The posts stand 30 m elsewhere; the gate lets in what makes the estimate follow."""
    path = site / "log" / "log.toml"
    path.write_text(path.read_text().replace("[8.0, -4.0]", "[38.0, -34.0]"))
    code, _, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--no-report"
    )
    assert code == 0
    warnings = [line for line in err.splitlines() if line.startswith("kedge: warning")]
    assert "further off than claimed; these results are not to be trusted" in warnings[0]
    scores = json.loads((site / "out" / "summary.json").read_text())["filters"]["extended"]
    assert scores["fits"] is False
    assert scores["sensors"]["camera"]["off_by"] > 10


@pytest.mark.slow
def test_a_rig_that_belongs_to_its_log_is_not_doubted(site, kedge):
    code, _, err = kedge(
        "estimate", site / "rig.toml", site / "log", "--out", site / "out", "--no-report",
        "--smooth",
    )  # fmt: skip
    assert code == 0
    assert "not to be trusted" not in err
    summary = json.loads((site / "out" / "summary.json").read_text())
    assert all(scores["fits"] for scores in summary["filters"].values())
