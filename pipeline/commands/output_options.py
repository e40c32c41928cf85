"""Options that say how much a long command tells, the same of every such command."""

from pathlib import Path
from typing import Annotated

import typer

QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show errors alone; the exit status says how it went.")
]
VerboseOption = Annotated[
    bool, typer.Option("--verbose", "-v", help="A line for every stage of every fruit, on a terminal too.")
]
LogOption = Annotated[
    Path | None,
    typer.Option("--log", metavar="FILE", help="Add every line, with its time in UTC, to this file."),
]
