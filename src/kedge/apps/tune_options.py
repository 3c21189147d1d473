"""Arguments and options of ``kedge tune``."""

from typing import Annotated

import typer

Logs = Annotated[
    list[str],
    typer.Argument(
        metavar="LOG...",
        help="Logs of one rig; PATH#PART picks a vehicle. Of several each is left out in turn.",
    ),
]
Parameters = Annotated[
    str | None,
    typer.Option(help="Names with commas between, instead of all noise of the rig."),
]
Horizons = Annotated[
    str | None,
    typer.Option(help="Judge readings as predicted over so many seconds, e.g. 1,5,20."),
]
WithTruth = Annotated[
    bool, typer.Option("--with-truth", help="Judge errors against the log's truth.")
]
HoldOut = Annotated[
    float | None,
    typer.Option(help="Share of one log, at its end, not tuned on but scored: 0.5."),
]
Blocks = Annotated[
    int | None, typer.Option(help="Leave each of so many parts of one log out in turn.")
]
LeaveOneOut = Annotated[
    bool | None,
    typer.Option(
        "--leave-one-out/--no-leave-one-out",
        help="Tune without each log or block, and score it; done if there are several.",
    ),
]
Starts = Annotated[int, typer.Option(help="From how many values to begin.")]
Span = Annotated[float, typer.Option(help="Stay within this factor of the rig's own values.")]
Bounds = Annotated[
    list[str] | None, typer.Option("--bounds", help="Other bounds: KEY=LOW:HIGH.")
]
