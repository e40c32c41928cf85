"""`drupe convert`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from pipeline.commands.endings import about
from pipeline.exit_status import DOUBTED, INTERRUPTED, UNUSABLE
from pipeline.safe_start import elsewhere


class Indenter(StrEnum):
    """The tip of a bare press."""

    BALL = "ball"
    FLAT = "flat"
    FLAT_PLATE = "plate"
    FLAT_PLATES = "plates"


class SpecimenChoice(StrEnum):
    """What is between plates."""

    CYLINDER = "cylinder"
    FRUIT = "fruit"


class EndsChoice(StrEnum):
    """Of a cylinder."""

    BONDED = "bonded"
    LUBRICATED = "lubricated"


class AxisChoice(StrEnum):
    """Along which of its diameters a fruit is compressed."""

    A = "a"
    B = "b"
    C = "c"


PRESSES: dict[Indenter, Literal["ball", "flat", "plate"]] = {
    Indenter.BALL: "ball",
    Indenter.FLAT: "flat",
    Indenter.FLAT_PLATE: "plate",
    Indenter.FLAT_PLATES: "plate",
}
"""What a recording says of each; one plate against a rigid base is two plates."""


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
    radius_mm: Annotated[float | None, typer.Option(min=0.001, help="The ball's or punch's radius.")] = None,
    thickness_mm: Annotated[
        float | None, typer.Option(min=0.1, max=200, help="Of a slab on a rigid base, under a ball or punch.")
    ] = None,
    specimen: Annotated[SpecimenChoice | None, typer.Option(help="What is between plates.")] = None,
    height_mm: Annotated[
        float | None, typer.Option(min=0.1, max=500, help="Of a cylinder between plates, unloaded.")
    ] = None,
    diameter_mm: Annotated[
        float | None, typer.Option(min=0.1, max=500, help="Of a cylinder between plates, unloaded.")
    ] = None,
    ends: Annotated[
        EndsChoice | None, typer.Option(help="Of a cylinder: glued (or rough), or sliding on oil.")
    ] = None,
    diameters_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="A B C", help="Of a fruit between plates: its three diameters."),
    ] = None,
    axis: Annotated[
        AxisChoice | None, typer.Option(help="Which of a fruit's diameters is between the plates.")
    ] = None,
    pit_share: Annotated[
        float | None,
        typer.Option(
            min=0, max=0.65, help="The pit's diameter over the fruit's; 0 for none (else the category's)."
        ),
    ] = None,
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
            help="Units that the table does not state: force=N (kN, lbf, kgf, ...), travel=mm (um, in, ...), "
            "time=s (ms, min, ...).",
        ),
    ] = None,
    sheet: Annotated[str | None, typer.Option(metavar="NAME", help="Which sheet of a spreadsheet.")] = None,
    run: Annotated[
        str | None,
        typer.Option(
            metavar="N|all",
            help="Which of several runs in one table, from 1; all writes OUT-1.h5, OUT-2.h5, ...",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The rig (drupe calibrate --rigid), whose give is taken off."),
    ] = None,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="Keep each gel's joint covariance at its greatest force.")
    ] = False,
) -> None:
    """Turn frames, tables or another maker's files into a recording that grade and explain read.

    Notes tell what was noticed (lost frames, torn markers, clocks apart, ...). The checks of `drupe check`
    that need no fruit run too. OUT.h5 appears whole or not at all. Exit status: 0 written, 1 internal error,
    2 usage, 3 SOURCE cannot be used (nothing is written) or `drupe grade` will refuse OUT.h5, 4 written, but
    E from it will be in doubt, 130 interrupted.
    """
    with elsewhere():
        from pipeline.recordings.conversion import ConvertRequest, convert_runs
        from pipeline.recordings.trace_options import ALL_RUNS, trace_words
        from pipeline.run.progress import StageLines
        from tactile.io.specimen import PressedSpecimen
        from tactile.tactile_failure import TactileFailure

    wanted = ConvertRequest(
        sensor=sensor,
        fruit_id=fruit,
        category=category,
        indenter=None if indenter is None else PRESSES[indenter],
        radius_mm=radius_mm,
        specimen=PressedSpecimen(
            kind=None if specimen is None else specimen.value,
            thickness_mm=thickness_mm,
            height_mm=height_mm,
            diameter_mm=diameter_mm,
            ends=None if ends is None else ends.value,
            diameters_mm=diameters_mm,
            axis=None if axis is None else axis.value,
            pit_share=pit_share,
        ),
        trace=trace_words(columns, units, sheet, run),
        all_runs=run == ALL_RUNS,
        rig=rig,
        covariance=covariance,
    )
    try:
        written = convert_runs(source, out, wanted, report=StageLines(Console(stderr=True)).stage)
    except TactileFailure as reason:
        typer.echo(f"drupe: {about(source, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; nothing was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for path, done in written:
        for note in done.notes:
            typer.echo(f"note: {note}")
        for doubt in done.doubts:
            typer.echo(f"E will be in doubt: {doubt}", err=True)
        for finding in done.refused:
            typer.echo(f"drupe grade will refuse this recording: {finding}", err=True)
        typer.echo(f"wrote {path}")
    if any(done.doubts or done.refused for _, done in written):
        raise typer.Exit(UNUSABLE if any(done.refused for _, done in written) else DOUBTED)
