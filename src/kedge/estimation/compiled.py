"""The pass over a log as machine code: for which filters, and how it is called.

What is compiled is the program that XLA would compile,
:func:`kedge.estimation.traced.pass_over`, so a vehicle, sensor or filter knows nothing of it.
"""

import os
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, Literal

import jax
import numpy as np
from jax.core import Tracer

from kedge.compiler.graph import Unsupported
from kedge.compiler.machine import is_available
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig
from kedge.estimation.traced import Estimates
from kedge.estimation.transition import innermost
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.filters.particle.cloud import AbstractParticleFilter

Engine = Literal["auto", "native", "xla"]
"""Who compiles the pass: LLVM by way of :mod:`kedge.compiler`, or XLA.

``auto`` takes native code on a CPU in 64 bits, if the extra ``native`` is installed and the
filter is straight-line code: neither random numbers nor loops nor decompositions. The variable
``KEDGE_ENGINE`` says what ``auto`` stands for. Both engines compute the same terms; they round
differently, so results agree to about 1e-12 and the bytes are the same only within one engine.
"""


def compiled_pass(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    history: bool,
    engine: Engine = "auto",
    keep: Callable[[Estimates], Any] | None = None,
    per_run: Any = None,
    work: int = 0,
    pitches: tuple[int, int] | None = None,
) -> Any:
    """The pass in machine code, or None if XLA is to do it. Parameters must be arrays.

    ``own`` is a tree like ``(filter, rig, log)`` of flags: which arrays have a leading axis of
    runs. Without it there is one run. ``work`` is how many events are to be passed in all, over
    all runs: of many, a program is worth compiling that is too long for a few. With ``pitches``
    it works on rows (:data:`kedge.estimation.native.Pitches`).

    Raises:
        ContractError: ``engine`` is "native" and that is not possible.
    """
    chosen = (os.environ.get("KEDGE_ENGINE") or "auto") if engine == "auto" else engine
    if chosen not in ("auto", "native", "xla"):
        raise ContractError(f"engine is {chosen!r}; expected 'auto', 'native' or 'xla'")
    if chosen == "xla":
        return None
    why = _obstacle(filter, (filter, rig, log))
    if why is None:
        from kedge.estimation.native import native_pass

        try:
            return native_pass(filter, rig, log, history, keep, per_run, work, pitches)
        except Unsupported as error:
            why = str(error)
    if chosen == "native" and engine == "native":
        raise ContractError(f"engine 'native' cannot run {type(filter).__name__} here: {why}")
    return None


def _obstacle(filter: AbstractFilter, tree: Any) -> str | None:
    """Why this cannot be native code, as far as that is known without tracing."""
    if not is_available():
        return "llvmlite is not installed (the extra 'native')"
    if isinstance(innermost(filter), AbstractEnsembleFilter | AbstractParticleFilter):
        return "it draws random numbers"
    if jax.default_backend() != "cpu" or jax.dtypes.canonicalize_dtype(float) != np.float64:
        return "it is for 64-bit floats on a CPU"
    if any(getattr(jax.config, flag) for flag in ("jax_disable_jit", "jax_debug_nans")):
        return "JAX is being debugged"
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree)):
        return "it stands within a traced program"
    return None


def compiler() -> dict[str, str]:
    """What results hang on beside the versions of JAX: who compiles the passes, if not XLA."""
    chosen = os.environ.get("KEDGE_ENGINE") or "auto"
    if chosen == "xla" or not is_available():
        return {}
    return {"llvmlite": version("llvmlite")}
