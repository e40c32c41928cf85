"""`drupe mat`."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from pipeline.safe_start import elsewhere

SHEETS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
"""Width and height of the sheets on which a printer can print a mat (ISO 216, ANSI/ASME Y14.1)."""


def mat(
    folder: Annotated[
        Path,
        Argument(metavar="DIR", help="The folder for mat.pdf and mat.json. Default: the current folder."),
    ] = Path(),
    paper: Annotated[Literal["a4", "letter"], Option(help="Paper size to print on.")] = "a4",
    cherry: Annotated[
        bool, Option("--cherry", help="Halve the tags and the blank centre, for cherries.")
    ] = False,
) -> None:
    """Write the marker mat: mat.pdf and mat.json.

    Print mat.pdf at 100 %, and copy mat.json beside batch.toml.

    Exit status: 0 written; 1 internal error; 2 usage; 130 interrupted.

    Example: drupe mat monday --paper a4
    """
    with elsewhere():
        from pipeline.batch.write_guard import require_new_or_ours
        from pipeline.files.whole_file import put
        from recon.cameras.printed_mat import mat_mapping, standard_mat, tag_bits
        from reports.mat_sheet import mat_sheet_pdf

    printed = standard_mat(tag_mm=9.0, gap_mm=2.5, margin_mm=8.5) if cherry else standard_mat()
    bits = {tag: tag_bits(printed.dictionary, tag) for tag in printed.corners_mm}
    title = f"drupe marker mat, {printed.tag_mm:g} mm tags"
    sheet = mat_sheet_pdf(printed.corners_mm, bits, sheet_mm=SHEETS_MM[paper], title=title)
    contents = {
        folder / "mat.pdf": sheet,
        folder / "mat.json": (json.dumps(mat_mapping(printed)) + "\n").encode(),
    }
    for path, content in contents.items():
        # Photos need the mat.json of their own mat: drupe never replaces one of another mat.
        require_new_or_ours(path, partial(_holds, content=content), f"this mat's {path.name}")
    for path, content in contents.items():
        put(path, content)
        typer.echo(f"wrote {path}")
    typer.echo("Print the PDF at 100 %, measure its bar, and copy mat.json beside batch.toml.")


def _holds(path: Path, *, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
