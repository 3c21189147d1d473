"""``kedge linearise``: the matrices of a rig about a state."""

from pathlib import Path
from typing import Annotated

import typer

from kedge.apps.console import print_json
from kedge.apps.options import Json, Set, Until

app = typer.Typer()


@app.command()
def linearise(
    name: Annotated[
        str, typer.Argument(metavar="RIG", help="A rig's or a scenario's name, or a TOML file.")
    ],
    log: Annotated[
        str | None, typer.Argument(metavar="LOG", help="For A and B along its estimate, too.")
    ] = None,
    at: Annotated[
        list[str] | None, typer.Option(help="COMPONENT=NUMBER of the state; else the prior's.")
    ] = None,
    control: Annotated[
        list[str] | None, typer.Option(help="COMPONENT=NUMBER of the control.")
    ] = None,
    dt: Annotated[float, typer.Option(help="Step of the discrete form, in s.")] = 0.1,
    until: Until = None,
    set_: Set = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for linear.mat.")] = None,
    as_json: Json = False,
) -> None:
    """A, B, C, D, Q, R about a state, discretised too; eigenvalues and ranks."""
    from kedge.apps.linearise import execute, print_linearised

    result = execute(name, log, at or [], control or [], dt, until, set_, out)
    if as_json:
        print_json(result.record())
        return
    print_linearised(result)
    if out is not None:
        print(f"\nresults: {out / 'linear.mat'}")
