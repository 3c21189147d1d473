"""The work behind ``init`` and ``show``: a first rig for a log, and a rig as it is resolved."""

from pathlib import Path
from typing import NamedTuple

from kedge.apps.first_rig import is_planar, rig_text
from kedge.config.problem import load_problem
from kedge.config.rigs import RigConfig, load_rig_config
from kedge.core.errors import DataError, KedgeError
from kedge.formats.atomic import replace_file
from kedge.formats.bag_config import BagConfig
from kedge.formats.readers import read_log
from kedge.formats.results import as_toml
from kedge.formats.sketch_bag import bag_text, sketch_bag
from kedge.formats.sketch_folder import format_of, log_text, sketch_folder
from kedge.formats.toml import Strict, quoted, read_toml

RIG, LOG = "rig.toml", "log.toml"


class BagPart(Strict):
    """The part of a rig file that is about a bag."""

    format: str
    bag: BagConfig


class FirstRig(NamedTuple):
    """What ``init`` made of a log."""

    files: list[Path]
    """What was written."""
    notes: list[str]
    """What of the log was left out, and why."""
    missing: str
    """What the rig still lacks to run on the log; "" if it runs."""


def init(log: Path, out: Path | None) -> FirstRig:
    """Write a first rig for a log, and for a folder of CSV files its ``log.toml``.

    Raises:
        DataError: a file is there already, or nothing in the log can be made out.
    """
    if not log.exists():
        raise DataError(f"{log}: no such file or folder")
    format = format_of(log) if log.is_file() else None
    bag = (log.is_file() and format is None) or (log / "metadata.yaml").exists()
    out = out or (log.parent if log.is_file() else log)
    names = [RIG] if bag or format or (log / LOG).exists() else [LOG, RIG]
    for name in names:
        if (out / name).exists():
            raise DataError(f"{out / name}: is there already; remove it, or name another --out")
    out.mkdir(parents=True, exist_ok=True)
    notes: list[str] = []
    title = f"title = {quoted(log.stem)}\n"
    if format:
        raw, source = read_log(str(log), format), str(log)
        preamble = f"{title}format = {quoted(format)}\n"
    elif bag:
        topics, others = sketch_bag(log)
        sets = {name: set(topic.columns) for name, topic in topics.items()}
        preamble = title + bag_text(topics, others, is_planar(sets))
        replace_file(out / RIG, preamble.encode())
        try:
            part = preamble.removeprefix(title)
            replace_file(out / RIG, part.encode())
            raw = read_log(str(log), "bag", read_toml(out / RIG, BagPart).bag)
        finally:
            (out / RIG).unlink()
        source = str(log)
    else:
        if LOG in names:
            sketched = sketch_folder(log, out)
            notes += [f"{name} was left out: {why}" for name, why in sketched.skipped.items()]
            replace_file(out / LOG, log_text(sketched, log.name).encode())
        try:
            raw = read_log(str(out if LOG in names else log))
        except DataError:
            if LOG in names:
                (out / LOG).rename(out / f"{LOG}.draft")
            raise
        preamble, source = title, str(out if LOG in names else log)
    replace_file(out / RIG, rig_text(raw, preamble).encode())
    missing = ""
    try:
        load_problem(str(out / RIG), source)
    except KedgeError as error:
        missing = str(error)
    return FirstRig([out / name for name in names], notes, missing)


def show(rig: str) -> str:
    """A rig with everything that it extends and all that it does not say, as TOML."""
    config: RigConfig = load_rig_config(rig)
    return as_toml(config.model_dump(mode="json", exclude_none=True))
