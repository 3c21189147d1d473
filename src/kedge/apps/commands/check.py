"""``kedge check``: is a rig honest on a log, without truth?"""

from pathlib import Path
from typing import Annotated

import typer

from kedge.apps.options import Json, Report, Require, Seed, Set, Until
from kedge.core.errors import ConfigError

app = typer.Typer()


@app.command()
def check(
    rig: Annotated[
        str | None, typer.Argument(help="A shipped rig's name or a TOML file.")
    ] = None,
    log: Annotated[
        str | None, typer.Argument(metavar="LOG", help="A log folder or a data set; PATH#PART.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results.")] = None,
    filter: Annotated[str | None, typer.Option(help="Instead of the rig's own.")] = None,
    until: Until = None,
    set_: Set = None,
    require_: Require = None,
    report: Report = True,
    self_test: Annotated[
        int, typer.Option(help="Check so many simulated logs with each known fault planted.")
    ] = 0,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Is a rig honest on a log, without truth? What is wrong, and what to write instead."""
    if not self_test and (rig is None or log is None):
        raise ConfigError("check: found no RIG and LOG, expected both, or --self-test N")
    from kedge.apps.check import check_log, self_test_table

    if rig is None or log is None:
        self_test_table(self_test, seed, as_json)
    else:
        check_log(rig, log, out, filter, until, set_, require_ or [], report, as_json)
