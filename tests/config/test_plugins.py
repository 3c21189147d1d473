"""A vehicle of the user's own, in one file beside the rig file."""

import re
from pathlib import Path

import numpy as np
import pytest

import kedge
from kedge.config.problem import load_problem
from kedge.config.rigs import load_rig_config
from kedge.core.errors import ConfigError

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "add-a-vehicle.md"
RIG = """
modules = ["trailer.py"]
[vehicle]
model = "trailer"
parameters = { drawbar = 6.0 }
[control]
source = "control"
[sensors.gnss]
model = "gnss"
[prior]
std = { position = 0.1, heading = 0.1, trailer_heading = 0.1 }
"""


@pytest.fixture
def folder(tmp_path):
    """The how-to's vehicle, a rig that names it, and a short log."""
    code = re.search(r"```python\n(.*?)```", HOW_TO.read_text(), re.DOTALL)[1]
    assert len(code.splitlines()) < 60
    (tmp_path / "trailer.py").write_text(code)
    (tmp_path / "rig.toml").write_text(RIG)
    log = tmp_path / "log"
    log.mkdir()
    (log / "log.toml").write_text(
        '[sources.control]\ncolumns = { speed = "m/s", steering = "rad" }\n'
        '[sources.gnss]\ncolumns = { position_x = "m", position_y = "m" }\n'
    )
    rows = "".join(f"{k / 10},5,0.1\n" for k in range(50))
    (log / "control.csv").write_text("time,speed,steering\n" + rows)
    fixes = "".join(f"{k},{5 * k},0\n" for k in range(1, 5))
    (log / "gnss.csv").write_text("time,position_x,position_y\n" + fixes)
    return tmp_path


def test_a_vehicle_beside_the_rig_runs(folder):
    problem = load_problem(str(folder / "rig.toml"), str(folder / "log"))
    found = kedge.estimate(kedge.make_filter("extended"), problem.rig, problem.recording.log)
    assert found.moments.cov.shape[1:] == (4, 4)
    assert np.isfinite(found.moments.cov).all()
    assert "trailer_heading" in kedge.space(problem.rig.prior.mean).labels


def test_a_module_that_is_not_there_is_named(folder):
    (folder / "trailer.py").unlink()
    (folder / "rig.toml").write_text(RIG.replace("trailer.py", "wagon.py"))
    with pytest.raises(ConfigError, match=r"rig\.toml: modules: wagon\.py: no such file"):
        load_rig_config(str(folder / "rig.toml"))


def test_a_module_that_fails_is_one_message(folder):
    (folder / "broken.py").write_text("import nothing_of_that_name\n")
    (folder / "rig.toml").write_text(RIG.replace("trailer.py", "broken.py"))
    with pytest.raises(ConfigError, match=r"broken\.py: ModuleNotFoundError"):
        load_rig_config(str(folder / "rig.toml"))
