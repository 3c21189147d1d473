"""A vehicle of the user's own, in one file beside the rig file."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import kedge
from kedge.config.problem import load_problem
from kedge.config.rigs import load_rig_config
from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError
from kedge.core.registry import vehicles
from kedge.studies.engines import Job

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
    with pytest.raises(ConfigError, match=r"modules: broken\.py:1: ModuleNotFoundError"):
        load_rig_config(str(folder / "rig.toml"))


SLIPS = {
    "a name that is not there": (
        "jnp.tan(steering)", "jnp.tan(steerign)", "NameError", "jnp.tan(steerign)"
    ),
    "a field not in the control": (
        "control.steering +", "control.rudder +", "rudder", "control.rudder"
    ),
    "rates that forget a field": (
        "            trailer_heading=speed / self.drawbar * jnp.sin(hitch),\n", "",
        "trailer_heading", "return State(\n",
    ),
    "rates of another form": ("return State(\n", "return Turned(\n", "Turned", "def rates"),
    "a field of another shape": (
        "position=speed * direction(state.heading)", "position=speed",
        r"position of shape \(\)", "def rates",
    ),
}  # fmt: skip
TURNED = """class Turned(NamedTuple):
    position: Position
    heading: Heading
    trailer_heading: Heading


"""


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_in_a_vehicle_is_one_line_with_its_place(folder, slip, kedge):
    old, new, what, mark = SLIPS[slip]
    code = (folder / "trailer.py").read_text()
    assert old in code
    code = code.replace(old, new)
    if "Turned" in new:
        code = code.replace("@vehicles", f"{TURNED}@vehicles")
    (folder / "trailer.py").write_text(code)
    line = code[: code.index(mark)].count("\n") + 1
    status, _, err = kedge(
        "estimate", folder / "rig.toml", folder / "log", "--out", folder / "out"
    )
    message = [text for text in err.splitlines() if not text.startswith("[")]
    assert status == 2
    assert len(message) == 1, err
    assert re.search(rf"trailer\.py:{line}: .*{what}", message[0]), err
    assert not (folder / "out").exists()


SENSOR = """
from typing import NamedTuple

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Heading, Metres, Position, Scalar, Speed
from kedge.core.registry import sensors


class Reads(NamedTuple):
    {field}


class Offset(NamedTuple):
    position: Position


@sensors.add("offset")
class OffsetFix(AbstractSensor[Offset]):
    reads = Reads
    measures = Offset
    offset: Metres = 1.0

    def observe(self, state: Reads) -> Offset:
        return {value}

    def noise_std(self, state: Reads) -> Offset:
        return Offset(0.1 + 0.0 * state.position)
"""


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("position: Position", "Offset(state.position + self.offset)", None),
        ("position: Position", "Offset(state.position + self.ofset)", r"fix\.py:24: .*ofset"),
        ("position: Position", "Offset(state.heading)", r"fix\.py:24: .*heading"),
        ("position: Position", "state.position", r"fix\.py:23: .*observe returns .*Offset"),
        ("speed: Speed", "Offset(state.speed)", r"fix\.py: .*reads .*speed"),
    ],
    ids=["whole", "a typo", "a field not shown", "no measurement", "a field not there"],
)
def test_a_slip_in_a_sensor_is_one_line_with_its_place(folder, field, value, message, kedge):
    (folder / "fix.py").write_text(SENSOR.format(field=field, value=value))
    rig = RIG.replace('"trailer.py"', '"trailer.py", "fix.py"').replace('"gnss"', '"offset"')
    (folder / "rig.toml").write_text(rig)
    arguments = ["estimate", folder / "rig.toml", folder / "log", "--out", folder / "out"]
    status, _, err = kedge(*arguments, "--no-report")
    if message is None:
        assert status == 0, err
        return
    shown = [text for text in err.splitlines() if not text.startswith("[")]
    assert status == 2
    assert len(shown) == 1, err
    assert re.search(message, shown[0]), err


def test_a_job_brings_its_modules_along(folder):
    """As when shards are merged in a process that has read no scenario."""
    scenario = RIG.replace('[control]\nsource = "control"\n', "") + (
        '[scenario]\ntitle = "a trailer"\nsource = "none"\nduration = 1.0\n'
        'filters = ["extended"]\n'
    )
    (folder / "base.toml").write_text(scenario)
    (folder / "more.toml").write_text('extends = "base.toml"\n[scenario]\nduration = 2.0\n')
    setting = load_scenario(str(folder / "more.toml"))
    configuration = setting.config.model_dump_json(exclude_none=True)
    job = Job(configuration, ("extended",), 2, 0, 2, setting.config.origin)
    vehicles._members.pop("trailer")
    del sys.modules["kedge_module_trailer"]
    assert job.build().setting.config.scenario.duration == 2.0
