"""``kedge linearise``: what it prints and leaves, and what it refuses."""

import json

import numpy as np
import pytest
from scipy.io import loadmat

pytestmark = pytest.mark.slow


def test_a_scenario_as_json(kedge):
    code, out, err = kedge("linearise", "yard", "--at", "heading=0.5", "--dt", 0.2, "--json")
    assert code == 0, err
    record = json.loads(out)
    A, B = np.array(record["A"]), np.array(record["B"])
    heading = record["states"].index("heading")
    speed = record["inputs"].index("speed")
    np.testing.assert_allclose(B[:2, speed], [np.cos(0.5), np.sin(0.5)])
    assert not A[heading].any()
    assert record["observability"]["rank"] == 3


def test_along_a_log(site, kedge):
    out = site / "linear"
    code, text, err = kedge("linearise", site / "rig.toml", site / "log", "--out", out)
    assert code == 0, err
    assert "observability: rank 3 of 3" in text
    matrices = loadmat(out / "linear.mat")
    assert matrices["A_along"].shape == (*matrices["time"].shape[1:], 3, 3)
    assert np.isfinite(matrices["B_along"]).all()


def test_an_unknown_component_is_one_line(kedge):
    code, _, err = kedge("linearise", "yard", "--at", "headin=0.5")
    assert code == 2
    assert "expected COMPONENT=NUMBER, of position_x, position_y, heading" in err
