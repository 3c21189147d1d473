"""The command line. Commands import what they need when they run, so ``--help`` is quick."""

import importlib
import pkgutil
from pathlib import Path
from typing import Annotated

import typer
import typer.main

from kedge import __version__
from kedge.apps import commands
from kedge.apps import tune_options as tuning
from kedge.apps.console import (
    check_requirements,
    finish,
    parse_requirements,
    print_filters,
    print_json,
    require,
)
from kedge.apps.failures import run
from kedge.apps.options import (
    LARGEST_SEED,
    FirstOut,
    Force,
    ForceResults,
    Json,
    Out,
    Report,
    Require,
    Resume,
    Rig,
    Seed,
    Set,
    SetScenario,
    Source,
    Truth,
    Undeclared,
    Until,
)

app = typer.Typer(
    name="kedge",
    help="Know where your vehicle is, and how sure you are.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _, name, _ in pkgutil.iter_modules(commands.__path__):
    app.add_typer(importlib.import_module(f"{commands.__name__}.{name}").app)


@app.command("list")
def list_(
    what: Annotated[str, typer.Argument(help="A family, or 'all'.")] = "all",
    as_json: Json = False,
) -> None:
    """Vehicles, sensors, filters, rigs, scenarios and data sets that there are."""
    from kedge.apps.catalogue import catalogue, print_catalogue

    families = catalogue(what)
    if as_json:
        print_json(families)
    else:
        print_catalogue(families)


@app.command()
def init(log: Undeclared, out: FirstOut = None) -> None:
    """A first rig for a log, and log.toml for a folder of CSV files: to be read and edited."""
    from kedge.apps.init import init as write_first

    first = write_first(log, out)
    for path in first.files:
        print(path)
    for note in first.notes:
        typer.echo(f"note: {note}", err=True)
    if first.missing:
        typer.echo(f"kedge: warning: the rig needs an edit first: {first.missing}", err=True)
    else:
        typer.echo(
            "note: noises, scales and mounts of the rig are guesses; its spreads may be "
            f"far too small: `kedge check {first.files[-1]} LOG` says what is not honest",
            err=True,
        )


@app.command()
def show(rig: Rig) -> None:
    """Print a rig as TOML, with all that it extends and leaves to defaults."""
    from kedge.apps.init import show as resolved

    print(resolved(rig), end="")


@app.command()
def estimate(
    rig: Rig,
    log: Source,
    out: Out,
    filter: Annotated[
        str | None,
        typer.Option(help="Instead of the rig's own; NAME+map: the most probable trajectory."),
    ] = None,
    smooth: Annotated[bool, typer.Option("--smooth", help="Smooth it as well.")] = False,
    truth: Truth = "auto",
    until: Until = None,
    seed: Seed = 0,
    set_: Set = None,
    force: ForceResults = False,
    require_: Require = None,
    report: Report = True,
    as_json: Json = False,
) -> None:
    """One filter over a recorded log."""
    from kedge.apps.workflow import execute, load

    conditions = parse_requirements(require_ or [])
    problem = load(rig, log, truth, until, set_)
    name = filter or problem.filter
    names = [name, f"{name}+smoother"] if smooth else [name]
    check_requirements(conditions, names, sensors=[s.name for s in problem.rig.sensors])
    summary = execute(problem, names, out, "estimate", seed, report, force)
    finish(summary, out, conditions, as_json, print_filters)


@app.command()
def compare(
    rig: Rig,
    log: Source,
    out: Out,
    filters: Annotated[
        str,
        typer.Option(
            help="Names with commas between; NAME+smoother smooths, NAME+map is the most "
            "probable trajectory."
        ),
    ] = "dead-reckoning,extended,unscented,extended+smoother",
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Smooth every filter that can be.")
    ] = False,
    truth: Truth = "auto",
    until: Until = None,
    seed: Seed = 0,
    set_: Set = None,
    force: ForceResults = False,
    require_: Require = None,
    report: Report = True,
    as_json: Json = False,
) -> None:
    """Several filters over one recorded log."""
    from kedge.apps.workflow import execute, load, with_smoothers
    from kedge.config.filters import split_names

    conditions, names = parse_requirements(require_ or []), split_names(filters)
    names = with_smoothers(names) if smooth else names
    problem = load(rig, log, truth, until, set_)
    check_requirements(conditions, names, sensors=[s.name for s in problem.rig.sensors])
    summary = execute(problem, names, out, "compare", seed, report, force)
    finish(summary, out, conditions, as_json, print_filters)


@app.command()
def locate(
    rig: Rig,
    log: Source,
    out: Out,
    solvers: Annotated[
        str, typer.Option(help="Names with commas between: ls, wls, gls, ml, nls, em, tdoa.")
    ] = "ls,gls,ml,ml:loss=huber",
    sensor: Annotated[
        str | None, typer.Option(help="Whose ranges, if several have some.")
    ] = None,
    window: Annotated[float, typer.Option(help="Seconds that an epoch of ranges lasts.")] = 0.1,
    truth: Truth = "auto",
    until: Until = None,
    set_: Set = None,
    require_: Require = None,
    report: Report = True,
    as_json: Json = False,
) -> None:
    """A fix for every epoch of ranges in a log, each by itself."""
    from kedge.apps.locate import Options, execute, print_fixes
    from kedge.config.filters import split_names

    conditions, names = parse_requirements(require_ or []), split_names(solvers)
    check_requirements(conditions, names)
    options = Options(names, sensor, window, truth, until, set_, report)
    summary = execute(rig, log, out, options)
    finish(summary, out, conditions, as_json, print_fixes)


@app.command()
def study(
    scenario: Annotated[str, typer.Argument(help="A shipped scenario's name or a TOML file.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results.")] = None,
    runs: Annotated[
        int | None, typer.Option(max=10**7, help="Instead of the scenario's own.")
    ] = None,
    filters: Annotated[
        str | None, typer.Option(help="Names with commas between, instead of its own.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(max=LARGEST_SEED, help="Instead of the scenario's own.")
    ] = None,
    chunk: Annotated[
        int | None,
        typer.Option(
            help="Runs in one batch, instead of its own; another moves the last digits."
        ),
    ] = None,
    engine: Annotated[
        str, typer.Option(help="Who computes: local, processes (one a core) or dask.")
    ] = "local",
    scheduler: Annotated[
        str | None, typer.Option(help="Of the engine dask: tcp://HOST:PORT.")
    ] = None,
    shard: Annotated[
        str | None, typer.Option(help="Only part i of n: i/n; 'kedge merge' joins the parts.")
    ] = None,
    resume: Resume = False,
    force: Force = False,
    set_: SetScenario = None,
    require_: Require = None,
    report: Report = True,
    as_json: Json = False,
) -> None:
    """Several filters over the same simulated runs, beside published scores."""
    from kedge.apps.study import Options, execute
    from kedge.apps.study_output import print_study
    from kedge.studies.figures_of_merit import StudySummary

    conditions = parse_requirements(require_ or [])
    options = Options(
        out, runs, filters, seed, set_, chunk, engine=engine, scheduler=scheduler, shard=shard,
        resume=resume, force=force, report=report, require=conditions,
    )  # fmt: skip
    summary = execute(scenario, options)
    if isinstance(summary, StudySummary):
        finish(summary, out, conditions, as_json, print_study)
    elif as_json:
        print_json(summary)
    else:
        print(f"shard {shard}: {len(summary.chunks)} of {summary.of} chunks in {out}")


@app.command()
def merge(
    shards: Annotated[list[Path], typer.Argument(help="Folders that --shard left.")],
    out: Out,
    resume: Resume = False,
    force: Force = False,
    require_: Require = None,
    report: Report = True,
    as_json: Json = False,
) -> None:
    """Put the shards of a study together."""
    from kedge.apps.study import merge as merge_shards
    from kedge.apps.study_output import print_study

    conditions = parse_requirements(require_ or [])
    summary = merge_shards(shards, out, resume, force, report)
    finish(summary, out, conditions, as_json, print_study)


@app.command()
def tune(
    rig: Rig,
    logs: tuning.Logs,
    out: Out,
    filter: Annotated[str | None, typer.Option(help="Instead of the rig's own.")] = None,
    parameters: tuning.Parameters = None,
    horizons: tuning.Horizons = None,
    with_truth: tuning.WithTruth = False,
    hold_out: tuning.HoldOut = None,
    blocks: tuning.Blocks = None,
    leave_one_out: tuning.LeaveOneOut = None,
    starts: tuning.Starts = 4,
    span: tuning.Span = 1000.0,
    bounds: tuning.Bounds = None,
    until: Until = None,
    seed: Seed = 0,
    set_: Set = None,
    require_: Require = None,
    report: Annotated[bool, typer.Option(help="Draw the profiles of the loss.")] = True,
    as_json: Json = False,
) -> None:
    """Noise, scales and latencies of a rig from recorded logs."""
    from kedge.apps.tune import Options, execute
    from kedge.apps.tune_output import print_tuned

    conditions = parse_requirements(require_ or [])
    options = Options(
        filter, parameters, with_truth, hold_out, starts, span, bounds or (), until, seed,
        set_, report, horizons, blocks, leave_one_out,
    )  # fmt: skip
    summary = execute(rig, logs, out, options)
    if as_json:
        print_json(summary)
    else:
        print_tuned(summary)
        print(f"\nresults: {out / 'tuned.toml'}")
    require(summary["scores"], conditions, summary["warnings"])


@app.command()
def demo(
    out: Out = Path("kedge-demo"),
    until: Until = None,
    as_json: Json = False,
) -> None:
    """A real robot's recorded log, end to end: filters side by side, and a report."""
    from kedge.apps.demo import FILTERS, demo_problem
    from kedge.apps.workflow import execute

    problem = demo_problem(until)
    finish(execute(problem, FILTERS, out, "demo", 0), out, [], as_json, print_filters)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of what goes wrong.")
    ] = False,
) -> None:
    del debug  # any command takes it: main() has seen to it
    if version:
        print(__version__)
        raise typer.Exit


def main() -> None:
    """Run one command; what goes wrong becomes one message and an exit code."""
    run(typer.main.get_command(app))


if __name__ == "__main__":
    main()
