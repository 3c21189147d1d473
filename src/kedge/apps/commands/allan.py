"""``kedge allan``: the noise of an IMU."""

from pathlib import Path
from typing import Annotated

import typer

from kedge.apps.console import print_json
from kedge.apps.options import Json, Source

app = typer.Typer()


@app.command()
def allan(
    log: Source,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results.")] = None,
    source: Annotated[
        str | None, typer.Option(help="The IMU's source in the log; its first, if not said.")
    ] = None,
    format: Annotated[str, typer.Option(help="The log's format.")] = "folder",
    as_json: Json = False,
) -> None:
    """The noise of an IMU (N, B, K) from a record of it standing still."""
    from kedge.apps.allan import execute, print_allan

    summary = execute(log, format, source, out)
    if as_json:
        print_json(summary)
        return
    print_allan(summary)
    for note in summary["notes"]:
        print(f"note: {note}")
    if out is not None:
        print(f"\nresults: {out / 'summary.json'}")
