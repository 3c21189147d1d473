"""The work behind ``kedge study`` and ``kedge merge``: filters over a scenario's runs."""

import contextlib
import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from kedge.apps.console import Interrupted, check_requirements, console_progress
from kedge.apps.study_output import content_of, score_names, summary_of, write_study
from kedge.apps.workflow import settings
from kedge.config.filters import split_names
from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError, DataError
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.reports.page import require_studio
from kedge.reports.study_report import write_study_report
from kedge.studies.chunks import ChunkFolder, open_study, read_study, study_digest
from kedge.studies.engines import Built, Job, built, chosen
from kedge.studies.figures_of_merit import StudySummary
from kedge.studies.scores import Part, Tally, chunks_of, pack, unpack

FORMAT = 2
"""Of the chunks' files."""


class Options(NamedTuple):
    """How a study is run; None is what the scenario says."""

    out: Path | None = None
    runs: int | None = None
    filters: str | None = None
    seed: int | None = None
    changes: Sequence[str] | None = None
    chunk: int | None = None
    engine: str = "local"
    scheduler: str | None = None
    shard: str | None = None
    resume: bool = False
    force: bool = False
    report: bool = True
    require: Sequence[tuple[str, str, float]] = ()


@dataclass(frozen=True)
class ShardSummary:
    """What ``kedge study --shard i/n --json`` prints."""

    command: str
    shard: tuple[int, int]
    """i and n."""
    chunks: tuple[int, ...]
    """Those in the folder."""
    of: int
    digest: str
    """Of the study."""


def execute(name: str, options: Options) -> StudySummary | ShardSummary:
    """Read a scenario, run the study, write its folder if one is asked for.

    Of a shard only the chunks are written, and what is returned says which.

    Raises:
        KedgeError: the scenario cannot be used, a filter cannot run, or the folder cannot be
            written.
        Interrupted: by Ctrl-C; the chunks that were done are kept.
    """
    use_compilation_cache()
    engine = chosen(options.engine, options.scheduler)
    if options.report and options.out is not None and options.shard is None:
        require_studio()
    shard = None if options.shard is None else parse_shard(options.shard)
    if options.out is None and (shard or options.resume or options.force):
        raise ConfigError("--shard, --resume and --force need a folder: --out DIR")
    study = _built(name, options)
    job, trials = study.job, study.trials
    if options.require:
        names = score_names(study.setting, trials.study, job.filters)
        check_requirements(options.require, job.filters, names)
    chunks = trials.chunks
    mine = list(chunks) if shard is None else list(chunks)[shard[0] - 1 :: shard[1]]
    with contextlib.ExitStack() as stack:
        trials.progress = progress = stack.enter_context(console_progress())
        folder, done, parts = None, list[int](), dict[int, Part]()
        if options.out is not None:
            opening = open_study(options.out, _study(job, shard), options.resume, options.force)
            folder = stack.enter_context(opening)
            done, faults = folder.survey()
            for fault in faults:
                progress(f"{fault}; it is computed again")
        remaining = [number for number in mine if number not in done]
        if done:
            progress(f"{len(mine) - len(remaining)} of {len(mine)} chunks are there already")
        if remaining:
            trials.prepare()
        try:
            for count, (number, part) in enumerate(engine(study, remaining, progress), 1):
                if folder is None:
                    parts[number] = part
                else:
                    folder.save(number, pack(part))
                progress(f"{len(mine) - len(remaining) + count} of {len(mine)} chunks done")
        except KeyboardInterrupt:
            raise Interrupted(_kept(folder, mine, options)) from None
        if folder is None:
            return _summed(study, (parts[number] for number in chunks))[1]
        if shard is not None:
            return ShardSummary("study", shard, tuple(mine), len(chunks), folder.digest)
        return finish(study, folder, progress if options.report else None)


def merge(
    sources: Sequence[Path], out: Path, resume: bool, force: bool, report: bool = True
) -> StudySummary:
    """Put the shards of a study together, and write what one whole study leaves.

    Raises:
        DataError: the folders hold different studies, or chunks are missing.
    """
    if report:
        require_studio()
    studies = {source: read_study(source) for source in sources}
    first = next(iter(studies.values()))
    for source, study in studies.items():
        if study_digest(study) != study_digest(first):
            keys = sorted(k for k in first if study.get(k) != first[k] and k != "shard")
            raise DataError(
                f"{source}: holds another study than {sources[0]} (other: {', '.join(keys)}), "
                "expected shards of one study"
            )
    job = _job_of(first, sources[0])
    there: dict[int, ChunkFolder] = {}
    for source, study in studies.items():
        shard_folder = ChunkFolder(source, study)
        done, faults = shard_folder.survey()
        if faults:
            raise DataError(
                f"{faults[0]}; compute it again first (kedge study ... --out {source} --resume)"
            )
        there |= dict.fromkeys(done, shard_folder)
    whole = range(chunks_of(job.runs, job.chunk))
    if missing := [number for number in whole if number not in there]:
        raise DataError(
            f"merge: found {len(whole) - len(missing)} of {len(whole)} chunks; missing: "
            f"{', '.join(map(str, missing[:10]))}{' and more' * (len(missing) > 10)}; "
            "finish the shards first (kedge study ... --shard i/n --resume)"
        )
    with open_study(out, _study(job, None), resume, force) as folder:
        for number in whole:
            folder.write(number, there[number].read(number))
        with console_progress() as progress:
            return finish(job.build(), folder, progress if report else None)


def finish(
    study: Built, folder: ChunkFolder, reporting: Callable[[str], None] | None
) -> StudySummary:
    """Add up the chunks in their order, and write the results beside them.

    A report is drawn if there is somebody to tell: ``reporting``.
    """
    names = study.job.filters
    parts = (unpack(folder.load(number), names) for number in study.trials.chunks)
    tally, summary = _summed(study, parts)
    with folder.publishing() as draft:
        write_study(draft, summary, tally.results())
        if reporting is not None:
            reporting("drawing the report")
            write_study_report(draft, content_of(study.trials.study, tally, summary))
    return summary


def _summed(study: Built, parts: Iterable[Part]) -> tuple[Tally, StudySummary]:
    """All chunks, in their order."""
    tally = Tally(study.job.filters)
    for part in parts:
        tally.add(part)
    how, runs = study.trials.study, study.job.runs
    return tally, summary_of(study.setting, how, tally.results(), runs)


def parse_shard(text: str) -> tuple[int, int]:
    """``i/n`` as numbers.

    Raises:
        ConfigError: it is no share.
    """
    parts = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    index, count = map(int, parts.groups()) if parts else (0, 0)
    if not 1 <= index <= count:
        raise ConfigError(
            f"--shard: found {text[:40]!r}, expected i/n with i from 1 to n, e.g. 2/4"
        )
    return index, count


def _built(name: str, options: Options) -> Built:
    """What is to be computed, checked as far as that goes without computing it."""
    setting = load_scenario(name, settings(options.changes))
    about, spec = setting.config.scenario, options.filters
    names = about.filters if spec is None else split_names(spec)
    if len(set(names)) < len(names) or "" in names:
        raise ConfigError(
            f"--filters {spec!r}: found a name twice or none, expected each filter once"
        )
    job = Job(
        configuration=setting.config.model_dump_json(exclude_none=True),
        filters=tuple(names),
        runs=about.runs if options.runs is None else options.runs,
        seed=about.seed if options.seed is None else options.seed,
        chunk=about.chunk if options.chunk is None else options.chunk,
        origin=setting.config.origin,
    )
    study = built(job, setting)
    return study._replace(job=job._replace(chunk=study.trials.chunk))


def _kept(folder: ChunkFolder | None, mine: Sequence[int], options: Options) -> str:
    """What an interrupted study leaves."""
    if folder is None:
        return "nothing is kept"
    if options.force and not folder.kept:
        return f"nothing new is kept; {options.out} holds what it held"
    kept = len(set(folder.survey()[0]) & set(mine)) if folder.kept else 0
    text = f"{kept} of {len(mine)} chunks are kept in {options.out}; --resume goes on"
    return text if kept else "nothing is kept"


def _study(job: Job, shard: tuple[int, int] | None) -> dict[str, Any]:
    """The job for ``study.json``."""
    found = job._asdict() | {"configuration": json.loads(job.configuration)}
    return found | {"format": FORMAT, "shard": None if shard is None else list(shard)}


def _job_of(study: dict[str, Any], source: Path) -> Job:
    """Undo :func:`_study`.

    Raises:
        DataError: it is of another version of kedge.
    """
    if study.get("format") != FORMAT or not set(Job._fields) <= set(study):
        raise DataError(f"{source}: was written by another version of kedge")
    given: dict[str, Any] = {key: study[key] for key in Job._fields}
    given["configuration"] = json.dumps(study["configuration"])
    given["filters"] = tuple(study["filters"])
    return Job(**given)
