"""``kedge datasets``: recordings that others published."""

import typer

from kedge.apps.console import print_json
from kedge.apps.options import Json

app = typer.Typer(name="datasets", help="Recorded data sets.", no_args_is_help=True)


@app.command("list")
def datasets_list(as_json: Json = False) -> None:
    """Data sets that kedge knows, and where each is on this machine."""
    from kedge.apps.catalogue import catalogue, print_catalogue

    families = catalogue("datasets")
    if as_json:
        print_json(families)
    else:
        print_catalogue(families)


@app.command("fetch")
def datasets_fetch(name: str) -> None:
    """Download a data set from its original source, and check every file."""
    from kedge.apps.console import console_progress
    from kedge.datasets.fetch import dataset, fetch

    with console_progress() as progress:
        progress(f"{name}: {dataset(name).url}")
        folder = fetch(name)
    print(folder)


@app.command("path")
def datasets_path(name: str) -> None:
    """Print where a data set is."""
    from kedge.datasets.fetch import require_located

    print(require_located(name))
