"""What is fed damaged input: every reader of files, and every text that a user types."""

import gzip
import random
import shutil
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
from mutation import mutated_bytes, mutated_text
from samples import bag_config, write_all

from kedge.apps.console import parse_requirements
from kedge.apps.study import parse_shard
from kedge.config.filters import build_filter, split_names
from kedge.config.problem import load_problem
from kedge.config.rigs import load_rig_config
from kedge.config.scenarios import load_scenario
from kedge.core.conditions import parse_condition
from kedge.core.errors import DataError
from kedge.formats.readers import read_log
from kedge.formats.tum import read_tum
from kedge.studies.chunks import ChunkFolder, read_study

Target = Callable[[random.Random], None]
FILTERS = (
    "extended", "robust:loss=cauchy,inner=(particle:count=500)", "ensemble:count=20",
    "gated:false_alarm=0.01,inner=unscented", "adaptive:inner=(gated:inner=extended)",
    "unscented:kappa=1.0", "particle:count=50,resampling=systematic",
)  # fmt: skip
CHANGES = (
    "output.rate=5", "sensors.camera.parameters.range_std=0.2", "prior.std.position=[0.1, 0.2]",
    'filter.name="unscented"', "vehicle.parameters={speed_noise = 0.1}", "output.rate=2.5",
)  # fmt: skip
TYPED = (
    "extended.rmse.position<=0.25",
    "extended.rmse.position < 1.5 * unscented.rmse.position",
)


class Targets:
    """The readers by name, each fed by a seeded draw, with a folder of its own to work in."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="kedge-fuzz-"))
        whole = self.folder / "whole"
        self.samples = write_all(whole)
        for format, path in self.samples.values():
            _read(path, format)  # whole, each is accepted
        self.work = self.folder / "work"
        self.rig = (whole.parent / "rig.toml").resolve()
        from commands import RIG

        self.rig.write_text(RIG)
        self.log = whole / "csv"
        self.configs = {
            kind: sorted(
                (Path(f.name).stem, f.read_text())
                for f in resources.files("kedge").joinpath(kind).iterdir()
                if f.name.endswith(".toml")
            )
            for kind in ("rigs", "scenarios")
        }
        study = {"configuration": {}, "filters": ["extended"], "runs": 4, "seed": 0, "chunk": 2}
        (whole / "study").mkdir()
        chunks = ChunkFolder(whole / "study", study | {"format": 1, "shard": None})
        for number in range(2):
            chunks.save(number, {"sums": np.arange(6.0), "count": np.arange(3)})
        tum = whole / "tum" / "poses.tum"
        self.by_name: dict[str, tuple[float, Target]] = {
            name: (1.0, self._reader(format, path))
            for name, (format, path) in self.samples.items()
        }
        self.by_name |= {
            "tum": (1.0, lambda draw: self._damaged(tum, draw, lambda p: read_tum(p))),
            "study and chunks": (2.0, self._chunks),
            "rig over a log": (1.0, self._rig_over_log),
            "rig": (1.0, self._rig),
            "scenario": (1.0, self._scenario),
            "--set": (2.0, self._set),
            "filter": (3.0, lambda draw: self._filter(draw)),
            "conditions": (1.0, self._typed),
        }

    def close(self) -> None:
        """Remove the files."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _reader(self, format: str, path: Path) -> Target:
        return lambda draw: self._damaged(path, draw, lambda copy: _read(copy, format))

    def _damaged(self, path: Path, draw: random.Random, read: Callable[[Path], object]) -> None:
        """Read a copy of a file or a folder of which one file was changed."""
        shutil.rmtree(self.work, ignore_errors=True)
        copy = self.work / path.name
        if path.is_dir():
            shutil.copytree(path, copy)
        else:
            self.work.mkdir()
            shutil.copy(path, copy)
        files = sorted(f for f in copy.rglob("*") if f.is_file()) if path.is_dir() else [copy]
        chosen = draw.choice(files)
        data = chosen.read_bytes()
        packed = chosen.suffix == ".gz" and draw.random() < 0.7
        data = gzip.decompress(data) if packed else data
        try:
            text = data.decode()
        except UnicodeDecodeError:
            text = ""
        if text and draw.random() < 0.8:
            data = mutated_text(text, draw).encode(errors="replace")
        else:
            data = mutated_bytes(data, draw)
        chosen.write_bytes(gzip.compress(data) if packed else data)
        read(copy)

    def _chunks(self, draw: random.Random) -> None:
        def read(folder: Path) -> None:
            chunks = ChunkFolder(folder, read_study(folder))
            numbers, faults = chunks.survey()
            for number in numbers:
                chunks.load(number)
            if faults:
                raise DataError("\n".join(faults))

        self._damaged(self.folder / "whole" / "study", draw, read)

    def _config(self, text: str, draw: random.Random) -> str:
        self.work.mkdir(exist_ok=True)
        path = self.work / "damaged.toml"
        path.write_text(mutated_text(text, draw), errors="replace")
        return str(path)

    def _rig(self, draw: random.Random) -> None:
        load_rig_config(self._config(draw.choice(self.configs["rigs"])[1], draw))

    def _rig_over_log(self, draw: random.Random) -> None:
        load_problem(self._config(self.rig.read_text(), draw), str(self.log))

    def _scenario(self, draw: random.Random) -> None:
        load_scenario(self._config(draw.choice(self.configs["scenarios"])[1], draw))

    def _set(self, draw: random.Random) -> None:
        key, _, value = mutated_text(draw.choice(CHANGES), draw).partition("=")
        load_rig_config(str(self.rig), {key: value})

    def _filter(self, draw: random.Random) -> None:
        for name in split_names(mutated_text(",".join(draw.sample(FILTERS, 2)), draw)):
            build_filter(name)

    def _typed(self, draw: random.Random) -> None:
        text = mutated_text(draw.choice(TYPED), draw)
        match draw.randrange(3):
            case 0:
                parse_requirements([text])
            case 1:
                parse_condition(text)
            case 2:
                parse_shard(mutated_text("2/4", draw))


def _read(path: Path, format: str) -> None:
    read_log(str(path), format, bag_config() if format == "bag" else None)
