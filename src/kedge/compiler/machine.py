"""Assembly language to machine code by LLVM, kept on disk for the next time."""

import ctypes
import functools as ft
import hashlib
import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from kedge.compiler.emit import NAME
from kedge.compiler.graph import Unsupported


class Code:
    """A compiled function; it stays as long as this object does."""

    def __init__(self, engine: Any):
        self.engine = engine
        address = engine.get_function_address(NAME)
        self.call: Callable[[int], None] = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address)


def is_available() -> bool:
    """Whether LLVM is installed (the extra ``native``)."""
    return find_spec("llvmlite") is not None


def cache_folder() -> Path:
    """Where compiled functions are kept: ``KEDGE_NATIVE_CACHE`` or the user's cache."""
    given = os.environ.get("KEDGE_NATIVE_CACHE")
    return Path(given) if given else user_cache_path("kedge") / "native"


@ft.cache
def _target() -> Any:
    import llvmlite.binding as llvm

    try:
        llvm.initialize()
    except RuntimeError:
        pass  # newer versions do it themselves
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


def _machine() -> Any:
    llvm = _target()
    features = llvm.get_host_cpu_features().flatten()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=features, opt=2, jit=True
    )


def key_of(text: str) -> str:
    """What the machine code hangs on: the text, the compiler, the processor."""
    import llvmlite

    llvm = _target()
    parts = (
        text,
        llvmlite.__version__,
        str(llvm.llvm_version_info),
        llvm.get_host_cpu_name(),
        str(llvm.get_host_cpu_features().flatten()),
    )
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def compile_text(text: str) -> Code:
    """Machine code of a module: from the cache, or made and kept there.

    Raises:
        Unsupported: LLVM does not accept it.
    """
    llvm = _target()
    path = cache_folder() / f"{key_of(text)}.o"
    machine = _machine()
    try:
        kept = path.read_bytes()
    except OSError:
        kept = None
    if kept is not None:
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(kept))
        engine.finalize_object()
        return Code(engine)
    try:
        module = llvm.parse_assembly(text)
        module.verify()
    except RuntimeError as error:
        raise Unsupported(f"LLVM: {str(error)[:300]}") from error
    _optimise(llvm, machine, module)
    made = machine.emit_object(module)
    _keep(path, made)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(made))
    engine.finalize_object()
    return Code(engine)


def _optimise(llvm: Any, machine: Any, module: Any) -> None:
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    options.loop_vectorization = options.slp_vectorization = options.loop_unrolling = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)


def _keep(path: Path, made: bytes) -> None:
    """Write whole or not at all; a cache that cannot be written is no error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(made)
        part.replace(path)
    except OSError:
        pass
