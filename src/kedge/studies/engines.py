"""Who computes a study's chunks: this process, several of them, or the workers of a cluster.

Each engine gives back chunks as they come; which engine it was, and in which order they came,
changes no number.
"""

import asyncio
import contextlib
import functools
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any, NamedTuple

from kedge.config.plugins import load_modules
from kedge.config.scenarios import ScenarioConfig, Setting, build_setting
from kedge.core.errors import ConfigError, KedgeError
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.studies.scores import Part
from kedge.studies.study import Study
from kedge.studies.trials import Trials

ENGINES = ("local", "processes", "dask")
ANSWER = 8.0  # s that a scheduler has to answer
ATTEMPTS = 3
"""How often chunks are begun anew that were lost with a process."""

Progress = Callable[[str], None]
Chunks = Iterator[tuple[int, Part]]


class Job(NamedTuple):
    """A study as text and numbers, so that it can be sent to another machine."""

    configuration: str
    """The scenario with all that was changed in it, as JSON."""
    filters: tuple[str, ...]
    runs: int
    seed: int
    chunk: int
    origin: str = ""
    """The scenario's file, from which modules of the user's own are found."""

    def build(self) -> "Built":
        """Make the study ready to be computed.

        Raises:
            KedgeError: the scenario or a filter cannot be built here.
        """
        if self.origin:
            load_modules(Path(self.origin))
        config = ScenarioConfig.model_validate_json(self.configuration)
        return built(self, build_setting(config))


class Built(NamedTuple):
    """A job with what was built of it, once in a process."""

    job: Job
    setting: Setting
    trials: Trials


def built(job: Job, setting: Setting) -> Built:
    """A job of a scenario that is built already.

    Raises:
        KedgeError: a filter cannot be built, or the study cannot be scored.
    """
    filters = {name: setting.config.scenario.filter_of(name) for name in job.filters}
    return Built(
        job, setting, Trials(study_of(setting, job.seed), filters, job.runs, job.chunk)
    )


def study_of(setting: Setting, seed: int) -> Study:
    """How a scenario file is scored."""
    about = setting.config.scenario
    how = about.burn_in, about.score, about.start, seed
    windows = setting.config.windows
    return Study(setting.scenario, *how, setting.vehicles, about.field, windows)


def compute(job: Job, number: int) -> Part:
    """Compute one chunk in a worker, which keeps what it compiled for the next."""
    with _alone:
        return _built(job).trials.part(number)


def local(study: Built, numbers: Sequence[int], progress: Progress) -> Chunks:
    """One batched computation after the other, in this process."""
    study.trials.progress = progress
    for number in numbers:
        yield number, study.trials.part(number)


def processes(study: Built, numbers: Sequence[int], progress: Progress) -> Chunks:
    """A process for each core; a chunk is a task.

    Raises:
        KedgeError: processes end again and again before their chunk is done.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool

    waiting = list(numbers)
    for _ in range(ATTEMPTS):
        if not waiting:
            return
        # Not forked: JAX's threads would not survive that.
        context = multiprocessing.get_context("spawn")
        count = min(os.cpu_count() or 1, len(waiting))
        progress(f"{count} processes, {len(waiting)} chunks")
        pool = ProcessPoolExecutor(count, context, _ignore_interrupts)
        try:
            tasks = {pool.submit(compute, study.job, number): number for number in waiting}
            for task in as_completed(tasks):
                part, number = task.result(), tasks.pop(task)
                waiting.remove(number)
                yield number, part
        except BrokenProcessPool:
            progress("a process ended before its chunk was done; its chunk is begun anew")
        finally:
            pool.shutdown(cancel_futures=True)
    if waiting:
        raise KedgeError(
            f"--engine processes: found {ATTEMPTS} times that a process ended before its chunk "
            f"was done (too little memory?); {len(waiting)} chunks are left"
        )


def dask(study: Built, numbers: Sequence[int], progress: Progress, scheduler: str) -> Chunks:
    """The workers of a Dask cluster, which need kedge installed; a chunk is a task.

    A chunk that is lost with a worker is given to another.

    Raises:
        KedgeError: the package ``distributed`` is not installed, or workers are lost again and
            again.
        ConfigError: the scheduler does not answer.
    """
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise KedgeError(
            f"--engine dask needs {error.name}, which is not installed; "
            "install it with: pip install 'kedge-nav[distributed]'"
        ) from error
    # What becomes of a connection is told below, once; its log has a traceback for each step.
    for name in ("distributed", "distributed.client"):  # the second has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        asyncio.run(asyncio.wait_for(_answer(scheduler), ANSWER))
        client: Any = distributed.Client(scheduler, timeout=ANSWER, set_as_default=False)
    except Exception as error:  # who knows what listens there, and what it says
        raise ConfigError(
            f"--scheduler {scheduler}: found no answer of one within {ANSWER:g} s, expected a "
            "running Dask scheduler such as tcp://127.0.0.1:8786"
        ) from error
    with client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        progress(
            f"{workers} workers, {len(numbers)} chunks" + ("; waiting" if not workers else "")
        )
        tasks = {
            client.submit(compute, study.job, n, pure=False, retries=1): n for n in numbers
        }
        try:
            for task in distributed.as_completed(list(tasks), loop=client.loop):
                part, number = task.result(), tasks.pop(task)
                task.release()
                yield number, part
        except distributed.KilledWorker as error:
            raise KedgeError(
                f"--engine dask: workers ended again and again before a chunk was done: {error}"
            ) from error
        except (CancelledError, OSError) as error:
            raise KedgeError(
                f"--scheduler {scheduler}: the connection was lost, {len(tasks)} chunks are "
                "not done; --resume goes on with those that are"
            ) from error
        finally:
            with contextlib.suppress(CancelledError, OSError):
                client.cancel(list(tasks))


async def _answer(scheduler: str) -> None:
    """See that somebody there speaks as Dask does; its client alone would wait for long."""
    from distributed.comm.core import connect

    await (await connect(scheduler, timeout=ANSWER)).close()


def chosen(
    engine: str, scheduler: str | None
) -> Callable[[Built, Sequence[int], Progress], Chunks]:
    """The engine of a name.

    Raises:
        ConfigError: there is no such engine, or a scheduler is missing or of no use.
    """
    if engine not in ENGINES:
        raise ConfigError(f"--engine: found {engine!r}, expected one of {list(ENGINES)}")
    if (engine == "dask") != (scheduler is not None):
        raise ConfigError(
            "--engine dask and --scheduler tcp://HOST:PORT go together: "
            f"found engine {engine!r} and scheduler {scheduler!r}"
        )
    if scheduler is not None:
        return functools.partial(dask, scheduler=scheduler)
    return {"local": local, "processes": processes}[engine]


_alone = threading.Lock()
"""A worker may have several threads; two of them would compile the same filter twice."""


@functools.lru_cache(maxsize=2)
def _built(job: Job) -> Built:
    use_compilation_cache()
    return job.build()


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the process that collects the chunks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
