"""``kedge check``: what it prints and leaves, and what it refuses."""

import json

import pytest


def test_it_needs_a_rig_and_a_log(kedge):
    code, _, err = kedge("check")
    assert code == 2
    assert "expected both, or --self-test N" in err


@pytest.mark.slow
def test_a_check_leaves_what_it_promises(site, kedge):
    out = site / "checked"
    code, text, err = kedge("check", site / "rig.toml", site / "log", "--out", out)
    assert code == 0, err
    assert "camera" in text
    assert {"kedge.json", "summary.json", "report.html"} <= {p.name for p in out.iterdir()}
    summary = json.loads((out / "summary.json").read_text())
    assert summary["filters"]["camera"]["readings"] == 39
    assert summary["filters"]["camera"]["stream"]["rate"] == pytest.approx(2.0)
    assert "control speed scale" in summary["quantities"]


@pytest.mark.slow
def test_what_is_wrong_is_advice_a_warning_and_exit_code_3(site, kedge):
    rows = (site / "log" / "odometry.csv").read_text().splitlines()
    turned = [rows[0]]
    for row in rows[1:]:
        time, speed, rate = row.split(",")
        turned.append(f"{time},{speed},{-float(rate)}")
    (site / "log" / "odometry.csv").write_text("\n".join(turned) + "\n")
    code, text, err = kedge(
        "check", site / "rig.toml", site / "log", "--json", "--require", "no warnings"
    )
    assert code == 3, err
    summary = json.loads(text)
    kinds = {(one["kind"], one["subject"]) for one in summary["findings"]}
    assert ("sign", "control") in kinds
    assert any("has the other sign" in line for line in summary["warnings"])
