"""``kedge serve``: a fleet, live."""

from typing import Annotated

import typer

app = typer.Typer()


@app.command()
def serve(
    host: Annotated[
        str, typer.Option(help="Another than this machine needs --token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="To listen at.")] = 8020,
    token: Annotated[str | None, typer.Option(help="What every request must bring.")] = None,
    speed: Annotated[float, typer.Option(help="Times as fast as the clock.")] = 1.0,
) -> None:
    """Simulate a small fleet, estimate it as it drives, and serve its frames."""
    from kedge.apps.serve import execute

    execute(host, port, token, speed)
