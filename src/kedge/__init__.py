"""kedge: know where your vehicle is, and how sure you are.

Frames: right-handed; the map is east-north-up (ENU), the body forward-left-up (REP-103).
Units: SI and radians everywhere inside; files and commands convert at the edge.
Time: int64 nanoseconds in logs, float64 seconds since the log's start in traced code.
Angles: differences lie in [-pi, pi); attitudes are unit quaternions (w, x, y, z), body to map.
Noise: ``_std`` is a standard deviation, ``_cov`` a covariance, ``noise_density`` a root power
spectral density in the unit per square root of hertz.

Numbers are 64-bit: importing kedge switches JAX to float64 unless ``JAX_ENABLE_X64`` is set.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kedge.core.beliefs import Gaussian as Gaussian
    from kedge.core.contracts import AbstractFilter as AbstractFilter
    from kedge.core.contracts import AbstractMeasurementModel as AbstractMeasurementModel
    from kedge.core.contracts import AbstractOdeVehicle as AbstractOdeVehicle
    from kedge.core.contracts import AbstractSensor as AbstractSensor
    from kedge.core.contracts import AbstractVehicle as AbstractVehicle
    from kedge.core.errors import ConfigError as ConfigError
    from kedge.core.errors import ContractError as ContractError
    from kedge.core.errors import DataError as DataError
    from kedge.core.errors import KedgeError as KedgeError
    from kedge.core.errors import UnknownName as UnknownName
    from kedge.core.manifolds import space as space
    from kedge.core.registry import make_filter as make_filter
    from kedge.core.registry import make_sensor as make_sensor
    from kedge.core.registry import make_vehicle as make_vehicle
    from kedge.core.verdicts import Verdict as Verdict
    from kedge.estimation.batch import Estimates as Estimates
    from kedge.estimation.batch import estimate as estimate
    from kedge.estimation.log import Log as Log
    from kedge.estimation.log import Recording as Recording
    from kedge.estimation.log import Truth as Truth
    from kedge.estimation.online import Estimator as Estimator
    from kedge.estimation.rig import Installation as Installation
    from kedge.estimation.rig import Mount as Mount
    from kedge.estimation.rig import Rig as Rig
    from kedge.estimation.runs import estimate_runs as estimate_runs
    from kedge.estimation.smoother import smooth as smooth
    from kedge.evaluation.score import score as score
    from kedge.simulation.scenario import Scenario as Scenario
    from kedge.simulation.simulate import record as record

__version__ = "0.1.0"

# The command line answers --help without JAX, so nothing is imported before it is used.
_PUBLIC = {
    "AbstractFilter": "kedge.core.contracts",
    "AbstractMeasurementModel": "kedge.core.contracts",
    "AbstractOdeVehicle": "kedge.core.contracts",
    "AbstractSensor": "kedge.core.contracts",
    "AbstractVehicle": "kedge.core.contracts",
    "ConfigError": "kedge.core.errors",
    "ContractError": "kedge.core.errors",
    "DataError": "kedge.core.errors",
    "Estimates": "kedge.estimation.batch",
    "Estimator": "kedge.estimation.online",
    "Gaussian": "kedge.core.beliefs",
    "Installation": "kedge.estimation.rig",
    "KedgeError": "kedge.core.errors",
    "Log": "kedge.estimation.log",
    "Mount": "kedge.estimation.rig",
    "Recording": "kedge.estimation.log",
    "Rig": "kedge.estimation.rig",
    "Scenario": "kedge.simulation.scenario",
    "Truth": "kedge.estimation.log",
    "UnknownName": "kedge.core.errors",
    "Verdict": "kedge.core.verdicts",
    "estimate": "kedge.estimation.batch",
    "estimate_runs": "kedge.estimation.runs",
    "make_filter": "kedge.core.registry",
    "make_sensor": "kedge.core.registry",
    "make_vehicle": "kedge.core.registry",
    "record": "kedge.simulation.simulate",
    "score": "kedge.evaluation.score",
    "smooth": "kedge.estimation.smoother",
    "space": "kedge.core.manifolds",
}

__all__ = [
    "AbstractFilter",
    "AbstractMeasurementModel",
    "AbstractOdeVehicle",
    "AbstractSensor",
    "AbstractVehicle",
    "ConfigError",
    "ContractError",
    "DataError",
    "Estimates",
    "Estimator",
    "Gaussian",
    "Installation",
    "KedgeError",
    "Log",
    "Mount",
    "Recording",
    "Rig",
    "Scenario",
    "Truth",
    "UnknownName",
    "Verdict",
    "__version__",
    "estimate",
    "estimate_runs",
    "make_filter",
    "make_sensor",
    "make_vehicle",
    "record",
    "score",
    "smooth",
    "space",
]

if "JAX_ENABLE_X64" not in os.environ:
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'kedge' has no attribute {name!r}")
