"""kedge: know where your vehicle is, and how sure you are.

Frames: right-handed; the map is east-north-up (ENU), the body forward-left-up (REP-103).
Units: SI and radians everywhere inside; files and commands convert at the edge.
Time: int64 nanoseconds in logs, float64 seconds since the log's start in traced code.
Angles: differences lie in [-pi, pi); attitudes are unit quaternions (w, x, y, z), body to map.
Noise: ``_std`` is a standard deviation, ``_cov`` a covariance, ``noise_density`` a root power
spectral density in the unit per square root of hertz.

Numbers are 64-bit: importing kedge switches JAX to float64 unless ``JAX_ENABLE_X64`` is set.
"""

import os
import sys

from kedge.core import lazy, moved

__version__ = "0.1.0"

if "JAX_ENABLE_X64" not in os.environ:
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"

moved.install()
# The command line answers --help without JAX, so nothing is imported before it is used.
__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__)
__all__ += ["__version__"]
