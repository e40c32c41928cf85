"""`drupe convert`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.endings import about
from pipeline.exit_status import INTERRUPTED, UNUSABLE
from pipeline.safe_start import elsewhere


class Indenter(StrEnum):
    """The tip of a bare press."""

    BALL = "ball"
    FLAT = "flat"
    FLAT_PLATE = "plate"


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A raw grasp (folder with grasp.toml), Tac3D arrays, .h5 with images, .npz, or a table "
            "(.csv, .txt, .tsv, .xls, .xlsx).",
        ),
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT.h5", help="The recording to write.")],
    sensor: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The sensor's description, for every pad.")
    ] = None,
    fruit: Annotated[
        str, typer.Option(metavar="ID", help="Whose recording, where SOURCE does not say.")
    ] = "unknown",
    category: Annotated[str, typer.Option(help="Kind of fruit, where SOURCE does not say.")] = "unknown",
    indenter: Annotated[Indenter | None, typer.Option(help="Of a bare load cell's trace.")] = None,
    radius_mm: Annotated[float | None, typer.Option(min=0.001, help="The indenter's radius.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="A load cell's columns: time=Time,force=Force,travel=Pos (or gap=..., which closes).",
        ),
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Units that no name says: force=N (mN, g, kgf), travel=mm (um, cm), time=s (ms, min).",
        ),
    ] = None,
    sheet: Annotated[str | None, typer.Option(metavar="NAME", help="Which sheet of a spreadsheet.")] = None,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The rig (drupe calibrate --rigid), whose give is taken off."),
    ] = None,
) -> None:
    """Turn frames, tables or another maker's files into a recording that grade and explain read.

    What was noticed on the way (lost frames, torn markers, clocks apart, ...) is said. OUT.h5 appears whole
    or not at all. Exit status: 0 written, 1 internal error, 2 usage, 3 SOURCE cannot be used, 130
    interrupted.
    """
    with elsewhere():
        from pipeline.recordings.conversion import ConvertRequest
        from pipeline.recordings.conversion import convert as convert_source
        from pipeline.recordings.trace_options import trace_words
        from pipeline.run.progress import StageLines
        from tactile.tactile_failure import TactileFailure

    wanted = ConvertRequest(
        sensor=sensor,
        fruit_id=fruit,
        category=category,
        indenter=indenter.value if indenter else None,
        radius_mm=radius_mm,
        trace=trace_words(columns, units, sheet),
        rig=rig,
    )
    try:
        notes = convert_source(source, out, wanted, report=StageLines(Console(stderr=True)).stage)
    except TactileFailure as reason:
        typer.echo(f"drupe: {about(source, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; nothing was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for note in notes:
        typer.echo(f"note: {note}")
    typer.echo(f"wrote {out}")
