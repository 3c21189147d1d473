"""Compiling for tests: what runs a few times should be compiled quickly."""

import functools as ft
from typing import Any

import jax

_OPTIONS: dict[str, Any] = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_parallel_codegen_split_count": 1,
}
if jax.__version_info__ < (0, 11):  # a name that XLA does not know is an error
    _OPTIONS["xla_cpu_use_fusion_emitters"] = False

quick_jit = ft.partial(jax.jit, compiler_options=_OPTIONS)
"""``jax.jit`` for what runs a few times only: compiles in a quarter of the time."""
