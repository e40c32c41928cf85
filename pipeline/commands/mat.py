"""`drupe mat`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.batch.paper_sizes import Paper
from pipeline.commands.endings import said_when_interrupted
from pipeline.safe_start import elsewhere


def mat(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where mat.pdf and mat.json are written.")
    ] = Path(),
    paper: Annotated[Paper, typer.Option(help="The sheet it is printed on.")] = Paper.A4,
    cherry: Annotated[bool, typer.Option("--cherry", help="Half-size tags and blank, for cherries.")] = False,
) -> None:
    """Write the marker mat: mat.pdf to print at 100 %, and the mat.json that goes beside batch.toml."""
    with elsewhere():
        from pipeline.batch.marker_mat import write_mat
    with said_when_interrupted(""):
        written = write_mat(folder, paper=paper, cherry=cherry)
    for path in written:
        typer.echo(f"wrote {path}")
    typer.echo("print the PDF at 100 %, measure its bar, and copy mat.json beside batch.toml")
