"""A vehicle, a sensor, a filter or a reader is one file: no list names it.

The file is dropped into the package of its family, or comes with a distribution of its own that
declares an entry point.
"""

import importlib
import json
import sys

import pytest

from kedge.core import registry
from kedge.core.errors import ContractError
from kedge.formats.readers import read_log
from kedge.testing import check_sensor, check_vehicle

VEHICLE = '''
from typing import NamedTuple
import jax.numpy as jnp
from kedge.core.contracts import AbstractOdeVehicle
from kedge.core.quantities import Position, Scalar, Velocity
from kedge.core.registry import vehicles

class State(NamedTuple):
    position: Position

class Control(NamedTuple):
    velocity: Velocity

@vehicles.add("newcomer")
class Punt(AbstractOdeVehicle[State, Control, Control]):
    """A boat that is pushed.

    Source: none, Test, 2026, section 1.
    """

    velocity_noise: Scalar = 0.1

    def rates(self, state: State, control: Control, noise: Control) -> State:
        return State(control.velocity + noise.velocity)

    def noise_density(self) -> Control:
        return Control(jnp.full(2, self.velocity_noise))

    def start(self) -> State:
        return State(jnp.zeros(2))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(jnp.array([1.0, 0.0]))
'''
SENSOR = '''
from typing import NamedTuple
import jax.numpy as jnp
from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position
from kedge.core.registry import sensors

class Reads(NamedTuple):
    position: Position

class Measurement(NamedTuple):
    offset: Metres

@sensors.add("newcomer")
class LineOfSight(AbstractSensor[Measurement]):
    """How far from a line.

    Source: none, Test, 2026, section 2.
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 1.0
    std: Metres = 0.1

    def observe(self, state: Reads) -> Measurement:
        return Measurement(0.6 * state.position[0] + 0.8 * state.position[1])

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.asarray(self.std))
'''
FILTER = '''
from kedge.core.registry import filters
from kedge.filters.gaussian.extended import ExtendedKalman

@filters.add("newcomer")
class Sceptic(ExtendedKalman):
    """The extended filter under another name.

    Source: none, Test, 2026, section 3.
    """
'''
READER = '''
"""Punts on a river: times and speeds, without a header."""
from pathlib import Path
import numpy as np
from kedge.core.registry import readers
from kedge.formats.logs import RawLog
from kedge.formats.tables import table_of

@readers.add("newcomer")
def read_punts(path: Path, part: str | None = None) -> RawLog:
    """Read one file of times in seconds and speeds in knots."""
    time, speed = np.loadtxt(path).T
    stamps = np.int64(1e9 * time)
    columns = {"speed": (speed, "kn")}
    return RawLog("punts", {"log": table_of("log", path, stamps, columns)})
'''
SOURCES = {"vehicles": VEHICLE, "sensors": SENSOR, "filters": FILTER, "readers": READER}


@pytest.fixture(params=["file", "entry point"])
def newcomers(request, tmp_path, monkeypatch):
    """One member of each family is there, by a file in its folder or by an entry point."""
    families = {name: getattr(registry, name) for name in SOURCES}
    for family in families.values():
        family.names()
        monkeypatch.setattr(family, "_members", dict(family._members))
        monkeypatch.setattr(family, "_complete", False)
    before = set(sys.modules)
    if request.param == "file":
        for family, source in SOURCES.items():
            folder = tmp_path / family
            folder.mkdir()
            (folder / "newcomer.py").write_text(source)
            package = importlib.import_module(families[family].packages[0])
            monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    else:
        points = ""
        for family, source in SOURCES.items():
            (tmp_path / f"somebodys_{family}.py").write_text(source)
            points += f"[kedge.{family}]\nnewcomer = somebodys_{family}\n"
        metadata = tmp_path / "somebodys-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: somebodys\nVersion: 1.0\n"
        )
        (metadata / "entry_points.txt").write_text(points)
        monkeypatch.syspath_prepend(tmp_path)
    yield families
    for name in set(sys.modules) - before:
        if "newcomer" in name or "somebodys" in name:
            del sys.modules[name]


def test_they_are_members_and_are_shown(newcomers, kedge):
    shown = json.loads(kedge("list", "--json")[1])
    assert all("newcomer" in shown[family] for family in newcomers)
    assert shown["vehicles"]["newcomer"]["state"] == {"position_x": "m", "position_y": "m"}
    assert shown["sensors"]["newcomer"]["reads"].keys() == {"position"}
    assert shown["datasets"]["newcomer"]["summary"].startswith("Punts on a river")


def test_they_keep_their_contracts(newcomers):
    check_vehicle("newcomer")
    check_sensor("newcomer")


def test_a_log_is_read_by_its_format(newcomers, tmp_path):
    (tmp_path / "punts.txt").write_text("0.0 1.0\n0.5 2.0\n")
    table = read_log(str(tmp_path / "punts.txt"), "newcomer").tables["log"]
    assert table.stamps.tolist() == [0, 500_000_000]
    assert table.columns["speed"].tolist() == pytest.approx([1852 / 3600, 2 * 1852 / 3600])


def test_a_reader_that_returns_something_else_is_refused(newcomers, tmp_path, monkeypatch):
    monkeypatch.setitem(newcomers["readers"]._members, "newcomer", lambda path, part: {})
    with pytest.raises(ContractError, match=r"reader 'newcomer' .* dict; expected a RawLog"):
        read_log(str(tmp_path), "newcomer")


def test_the_shipped_sets_have_readers_in_their_own_files():
    modules = {name: registry.readers.get(name).__module__ for name in registry.readers.names()}
    recorded = {
        name for name, module in modules.items() if module.startswith("kedge.datasets.")
    }
    assert recorded == {"folder", "bag", "mcap", "gpx", "nmea", "ublox"} ^ modules.keys()
    assert len({modules[name] for name in recorded}) == len(recorded)
