"""Studies and tuning for programs: what the commands do, by the same code."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kedge.apps.study_output import content_of, summary_of, write_study
from kedge.checking.advice import findings
from kedge.checking.check import check as run_check
from kedge.checking.summary import Finding
from kedge.config.loading import Settings, Source, as_overrides
from kedge.config.scenarios import Setting, load_scenario
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError, DataError
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.estimation.views import pandas_module
from kedge.evaluation.record import by_name
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.formats.results_folder import results_folder
from kedge.reports.study_report import write_study_report
from kedge.studies.engines import study_of
from kedge.studies.figures_of_merit import StudyScores, StudySummary
from kedge.studies.scores import Result, Tally
from kedge.studies.study import Study
from kedge.studies.trials import Trials
from kedge.tuning.evaluator import Case
from kedge.tuning.tunable import choose
from kedge.tuning.tuning import Search, Tuned
from kedge.tuning.tuning import tune as tuned_by

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingTypeStubs]

Progress = Callable[[str], None]


def _quiet(text: str) -> None:
    del text


@dataclasses.dataclass(frozen=True)
class StudyResults:
    """What a study came to, by filter."""

    setting: Setting
    study: Study
    tally: Tally
    summary: StudySummary
    """What ``summary.json`` is written from: ``kedge config schema summary`` describes it."""

    @property
    def scores(self) -> Mapping[str, StudyScores]:
        """The scores of each filter."""
        return self.summary.filters

    @property
    def results(self) -> Mapping[str, Result]:
        """By filter, numbers of each run and sums over the runs at each time."""
        return self.tally.results()

    def to_pandas(self) -> "pandas.DataFrame":
        """A row for each filter: the single numbers among its scores.

        Raises:
            KedgeError: pandas is not installed.
        """
        rows = {
            name: {key: score.value for key, score in by_name(row).items() if "." not in key}
            for name, row in self.scores.items()
        }
        return pandas_module().DataFrame.from_dict(rows, orient="index").rename_axis("filter")

    def report(self, folder: str | Path) -> Path:
        """Write summary, tables and report into a folder, like ``--out``; give the page.

        Raises:
            KedgeError: something else is in the folder, or matplotlib or jinja2 is not
                installed.
        """
        with results_folder(folder, "report") as draft:
            write_study(draft, self.summary, self.results)
            page = write_study_report(draft, content_of(self.study, self.tally, self.summary))
        return Path(folder) / page.name

    def _repr_html_(self) -> str:
        page: Any = self.to_pandas()
        return page.to_html(float_format="{:.4g}".format)


def study(
    scenario: Source,
    runs: int | None = None,
    filters: Mapping[str, AbstractFilter | str] | Sequence[str] | None = None,
    seed: int | None = None,
    settings: Settings | None = None,
    chunk: int | None = None,
    progress: Progress = _quiet,
) -> StudyResults:
    """Simulate a scenario many times, and run every filter over each run, in this process.

    The draws of a run hang on the seed, its number and, for filters that draw, the filter's
    name: with the names of the command line the figures are those of ``kedge study``.

    Args:
        scenario: a shipped scenario's name or a TOML file.
        runs: how many; as all that is not given, what the scenario says.
        filters: by name, each as an object or as it is typed; or the names alone.
        seed: of all draws.
        settings: dotted key of the scenario -> value, in place of what its file says.
        chunk: runs in one batch.
        progress: is told what is being done.

    Raises:
        KedgeError: the scenario cannot be used, or a filter cannot run on it.
    """
    setting = load_scenario(str(scenario), as_overrides(settings))
    about = setting.config.scenario
    chosen = about.filters if filters is None else filters
    named = dict(chosen) if isinstance(chosen, Mapping) else {name: name for name in chosen}
    built = {
        name: about.filter_of(filter) if isinstance(filter, str) else filter
        for name, filter in named.items()
    }
    how = study_of(setting, about.seed if seed is None else seed)
    count = about.runs if runs is None else runs
    batch = about.chunk if chunk is None else chunk
    tally = Trials(how, built, count, batch, progress).tally()
    return StudyResults(setting, how, tally, summary_of(setting, how, tally.results(), count))


def tune(
    rig: Rig | Sequence[Rig],
    log: Recording | Sequence[Recording],
    parameters: Sequence[str] | None = None,
    filter: AbstractFilter | None = None,
    with_truth: bool = False,
    until: float = math.inf,
    search: Search | None = None,
    progress: Progress = _quiet,
    horizons: Sequence[float] = (),
) -> Tuned:
    """Find the values under which logs are least surprising; ``.rig(rig)`` has them.

    Args:
        rig: where the search starts; of several logs one for each if their priors or maps
            differ.
        log: up to ``until`` seconds, it is what is judged; or several.
        parameters: keys or unique ends of them, ``std`` or ``gnss.parameters.std``; without
            any, all noise that the rig's behaviour depends on.
        filter: the extended filter, unless given.
        with_truth: judge the errors of the estimate, not its innovations.
        until: the rest of the log is left to judge the result by.
        search: starts, bounds and seed.
        progress: is told what is being done.
        horizons: s; judge readings as predicted over each, not from one to the next.

    Raises:
        DataError: ``with_truth`` without one, or nothing of a log is left to judge.
        ConfigError: a parameter is unknown, has no start above 0, or bad bounds.
        ContractError: the filter has no derivative in its noise, or there are not as many rigs
            as logs.
    """
    logs = [log] if isinstance(log, Recording) else list(log)
    rigs = [rig] * len(logs) if isinstance(rig, Rig) else list(rig)
    if not logs or len(rigs) != len(logs):
        raise ContractError(
            f"tune: found {len(rigs)} rigs for {len(logs)} logs, expected one for each"
        )
    if with_truth and any(one.truth is None for one in logs):
        raise DataError("tune: with_truth is set, but the log has no truth")
    cases = [
        Case(own, one, one.truth if with_truth else None, until)
        for own, one in zip(rigs, logs, strict=True)
    ]
    chosen = choose(rigs[0], parameters)
    return tuned_by(filter or ExtendedKalman(), cases, chosen, search, horizons, progress)


def check(
    rig: Rig, log: Recording, filter: AbstractFilter | None = None, progress: Progress = _quiet
) -> list[Finding]:
    """What in a rig a log contradicts, without truth; none if nothing does.

    Args:
        rig: whose scales, signs, clocks, lever arms, targets, noise and errors are questioned.
        log: what it is to be honest on.
        filter: the extended filter, unless given.
        progress: is told what is being done.

    Raises:
        DataError: no reading could be judged.
    """
    return findings(run_check(filter or ExtendedKalman(), rig, log, progress), {})
