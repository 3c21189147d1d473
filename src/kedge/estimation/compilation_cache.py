"""Where XLA's compiled programs are kept between commands."""

import os

import jax
from platformdirs import user_cache_path


def use_compilation_cache() -> None:
    """Keep compiled programs between commands, unless the user has said where himself."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = user_cache_path("kedge") / "compiled"
        jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
