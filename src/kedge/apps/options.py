"""Arguments and options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

Rig = Annotated[str, typer.Argument(help="A shipped rig's name or a TOML file.")]
Source = Annotated[
    str,
    typer.Argument(
        metavar="LOG", help="A log folder or a data set; PATH#PART picks a vehicle in it."
    ),
]
Undeclared = Annotated[
    Path, typer.Argument(metavar="LOG", help="A bag, or a folder of CSV files.")
]
FirstOut = Annotated[
    Path | None, typer.Option("--out", help="Folder to write to, not the log's own.")
]
Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
Json = Annotated[bool, typer.Option("--json", help="Print the summary to standard output.")]
Truth = Annotated[str, typer.Option(help="'auto': score if the log has truth; or 'none'.")]
Until = Annotated[float | None, typer.Option(help="Use only so many seconds of the log.")]
LARGEST_SEED = 2**63 - 1
Seed = Annotated[int, typer.Option(max=LARGEST_SEED, help="Seed of what is drawn at random.")]
Set = Annotated[
    list[str] | None, typer.Option("--set", help="Change the rig, e.g. output.rate=5.")
]
SetScenario = Annotated[
    list[str] | None,
    typer.Option("--set", help="Change the scenario, e.g. scenario.duration=20."),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        help="Exit with 3 unless it holds, e.g. 'extended.rmse.position<=0.25', "
        "'camera.fused>=0.9', 'no warnings'.",
    ),
]

Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with the study that the folder holds.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace the study that it holds.")]
ForceResults = Annotated[
    bool,
    typer.Option("--force", help="Replace earlier results also where you have changed them."),
]
Report = Annotated[bool, typer.Option(help="Draw the report and its figures.")]
