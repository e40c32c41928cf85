"""Options that say how much a long command tells, the same of every such command."""

from pathlib import Path
from typing import Annotated

import typer

QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print only errors; the exit status shows the outcome.")
]
VerboseOption = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print a line for every stage of every fruit.")
]
LogOption = Annotated[
    Path | None,
    typer.Option("--log", metavar="FILE", help="Append every line to this file, with its time in UTC."),
]
