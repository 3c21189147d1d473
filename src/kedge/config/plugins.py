"""A user's own vehicles, sensors and filters: Python files that a rig file names."""

import contextlib
import importlib.util
import sys
import tomllib
from pathlib import Path

from kedge.core.errors import ConfigError


def load_modules(rig: Path) -> None:
    """Run the files that the key ``modules`` of a rig file lists, so that they register.

    Paths are relative to the rig file. A rig with modules is as trusted as any program.

    Raises:
        ConfigError: a module is missing or cannot be run.
    """
    # What is wrong with the rig file itself is said when it is read as a whole.
    with contextlib.suppress(OSError, ValueError):
        names = tomllib.loads(rig.read_text(encoding="utf-8-sig")).get("modules", [])
        for name in names if isinstance(names, list) else []:
            if isinstance(name, str):
                _run((rig.parent / name).resolve(), f"{rig}: modules: {name}")


def _run(path: Path, place: str) -> None:
    name = f"kedge_module_{path.stem}"
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None) == str(path):
        return
    if not path.is_file():
        raise ConfigError(f"{place}: no such file; paths are relative to the rig file")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{place}: is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        # A user's own code may fail in any way; the rig is what cannot be used.
        del sys.modules[name]
        raise ConfigError(f"{place}: {type(error).__name__}: {error}") from error
