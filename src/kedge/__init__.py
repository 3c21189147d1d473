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
from typing import Any

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
    "make_filter": "kedge.core.registry",
    "make_sensor": "kedge.core.registry",
    "make_vehicle": "kedge.core.registry",
    "record": "kedge.simulation.simulate",
    "score": "kedge.evaluation.score",
    "smooth": "kedge.estimation.smoother",
    "space": "kedge.core.manifolds",
}

__all__ = ["__version__", *_PUBLIC]

if "JAX_ENABLE_X64" not in os.environ:
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'kedge' has no attribute {name!r}")
