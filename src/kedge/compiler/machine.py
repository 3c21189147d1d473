"""Assembly language to machine code by LLVM, kept on disk for the next time."""

import ctypes
import functools as ft
import hashlib
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from kedge.compiler import cache
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
    """What an entry hangs on: the text, the compiler, the processor, the form of entries."""
    import llvmlite

    llvm = _target()
    parts = (
        cache.MARK.decode(),
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
    llvm, key = _target(), key_of(text)
    code = cache.load(key)
    if code is None:
        code = _compiled(text)
        cache.store(key, code)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return Code(engine)


def _compiled(text: str) -> bytes:
    llvm, machine = _target(), _machine()
    try:
        module = llvm.parse_assembly(text)
        module.verify()
    except RuntimeError as error:
        raise Unsupported(f"LLVM: {str(error)[:300]}") from error
    _optimise(llvm, machine, module)
    return machine.emit_object(module)


def _optimise(llvm: Any, machine: Any, module: Any) -> None:
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    options.loop_vectorization = options.slp_vectorization = options.loop_unrolling = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
