"""The demo: a real robot's recorded log if it can be had, a simulated one otherwise."""

import sys
import tempfile
from pathlib import Path

import jax.numpy as jnp
import jax.random as jr

from kedge.config.problem import Problem, load_problem
from kedge.core.beliefs import Gaussian
from kedge.core.errors import DataError
from kedge.core.registry import make_sensor, make_vehicle
from kedge.datasets.fetch import fetch
from kedge.estimation.rig import Installation, Rig
from kedge.formats.logs import write_log
from kedge.formats.simulated import simulated_log
from kedge.reports.page import require_studio
from kedge.simulation.scenario import Scenario

FILTERS = ("dead-reckoning", "extended", "unscented", "extended+smoother")
ROBOT = 3


def demo_problem(until: float | None) -> Problem:
    """MRCLAM robot 3, or in one line why not, and a simulated log instead.

    Raises:
        KedgeError: what its report is drawn with is not installed.
    """
    require_studio()
    try:
        folder = fetch("mrclam")
    except DataError as error:
        print(f"no recorded data ({error}); a simulated log instead", file=sys.stderr)
        return simulated_problem(until)
    return load_problem("mrclam", f"{folder}#{ROBOT}", until=until)


def simulated_problem(until: float | None) -> Problem:
    """Ten minutes of the rig ``yard``, written as a log folder and read like any other."""
    vehicle = make_vehicle("unicycle", speed_noise=0.3, yaw_rate_noise=0.03)
    camera = Installation("camera", make_sensor("landmarks"), rate=2.0)
    rig = Rig(vehicle, (camera,), Gaussian(vehicle.start(), 1e-4 * jnp.eye(3)))
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        write_log(log, simulated_log(Scenario(rig, 600.0), jr.key(0), "simulated yard"))
        return load_problem("yard", str(log), until=until)
