"""``kedge config``: what configuration files may say."""

from typing import Annotated, Literal

import typer

from kedge.apps.console import print_json

app = typer.Typer(name="config", help="Configuration files.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Configuration files."""


@app.command("schema")
def config_schema(
    of: Annotated[
        Literal["rig", "log", "summary"],
        typer.Argument(help="A rig file, a log.toml, or a summary.json."),
    ] = "rig",
) -> None:
    """Print a JSON schema: of rig files, log.toml, or what commands leave as summary.json."""
    from kedge.apps.catalogue import schema

    print_json(schema(of))
