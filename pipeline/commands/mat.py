"""`drupe mat`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.endings import said_when_interrupted
from pipeline.safe_start import elsewhere


class Paper(StrEnum):
    """Name of a sheet that a mat can be printed on."""

    A4 = "a4"
    LETTER = "letter"

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height (ISO 216, ANSI/ASME Y14.1)."""
        return (210.0, 297.0) if self is Paper.A4 else (215.9, 279.4)


def mat(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="The folder for mat.pdf and mat.json. Default: the current folder."
        ),
    ] = Path(),
    paper: Annotated[Paper, typer.Option(help="Paper size to print on.")] = Paper.A4,
    cherry: Annotated[
        bool, typer.Option("--cherry", help="Halve the tags and the blank centre, for cherries.")
    ] = False,
) -> None:
    """Write the marker mat: mat.pdf and mat.json.

    Print mat.pdf at 100 %, and copy mat.json beside batch.toml.

    Exit status: 0 written; 1 internal error; 2 usage; 130 interrupted.

    Example: drupe mat monday --paper a4
    """
    with elsewhere():
        from pipeline.batch.marker_mat import write_mat
    with said_when_interrupted(""):
        written = write_mat(folder, sheet_mm=paper.size_mm, cherry=cherry)
    for path in written:
        typer.echo(f"wrote {path}")
    typer.echo("Print the PDF at 100 %, measure its bar, and copy mat.json beside batch.toml.")
