"""`drupe calibrate`."""

import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.endings import about
from pipeline.exit_status import INTERRUPTED, UNUSABLE
from pipeline.safe_start import elsewhere


class RigidShape(StrEnum):
    """What was squeezed to calibrate a rig."""

    BALL = "ball"
    BLOCK = "block"


def calibrate(
    sensor: Annotated[
        Path,
        typer.Argument(
            metavar="SENSOR.toml|SQUEEZE",
            help="The sensor's description as far as it is known; with --rigid a recording of a squeeze.",
        ),
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT.toml", help="The description to write.")],
    ball_mm: Annotated[float | None, typer.Option(min=0.001, help="Radius of the ball pressed in.")] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A picture of the untouched gel, for the ball.")
    ] = None,
    press: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="A picture of the ball in the gel (repeat).")
    ] = None,
    load_cell: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A raw press (grasp.toml, log.csv with fx_N to fz_N, frames)."),
    ] = None,
    rigid: Annotated[
        RigidShape | None,
        typer.Option(help="Calibrate a rig instead: the shape of the rigid object squeezed."),
    ] = None,
    size_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="The rigid ball's diameter, or block's thickness.")
    ] = None,
    rigid_object: Annotated[
        str | None, typer.Option("--object", metavar="WORDS", help="What it is, for the record.")
    ] = None,
    squeeze: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Another squeeze of the same object (repeat).")
    ] = None,
    columns: Annotated[
        str | None, typer.Option(metavar="LIST", help="A table's columns, as of drupe convert.")
    ] = None,
    units: Annotated[
        str | None, typer.Option(metavar="LIST", help="A table's units, as of drupe convert.")
    ] = None,
    sheet: Annotated[str | None, typer.Option(metavar="NAME", help="Which sheet of a spreadsheet.")] = None,
) -> None:
    """Complete a sensor's description from presses, or measure how far a rig gives way by itself.

    A ball of known radius gives a photometric sensor's look-up of slopes (written beside OUT.toml), a press
    with the machine's load cell the gel's modulus. With --rigid and --size-mm, squeezes of a rigid object
    give the rig's own travel over the force, which drupe convert --rig and rig = "OUT.toml" in batch.toml
    take off. Exit status: 0 written, 1 internal error, 2 usage, 3 a press cannot be used, 130 interrupted.
    """
    of_rigs = size_mm, rigid_object, squeeze, columns, units, sheet
    of_sensors = ball_mm, reference, press, load_cell
    if rigid is None and any(of_rigs):
        raise typer.BadParameter(
            "--size-mm, --object, --squeeze, --columns, --units and --sheet are of a rig; give --rigid "
            "ball or --rigid block with them."
        )
    if rigid is not None and (size_mm is None or any(of_sensors)):
        raise typer.BadParameter(
            "--rigid calibrates a rig: give --size-mm with it, and none of --ball-mm, --reference, "
            "--press and --load-cell, which are of a sensor."
        )
    with elsewhere():
        from pipeline.recordings.rig_calibration import RigidObject, calibrate_rig
        from pipeline.recordings.sensor_calibration import Presses
        from pipeline.recordings.sensor_calibration import calibrate as calibrate_sensor
        from pipeline.recordings.trace_options import trace_words
        from pipeline.run.progress import StageLines
        from tactile.tactile_failure import TactileFailure

    presses = Presses(ball_mm=ball_mm, reference=reference, ball=tuple(press or ()), load_cell=load_cell)
    report = StageLines(Console(stderr=True)).stage
    try:
        if rigid is not None and size_mm is not None:
            said = calibrate_rig(
                [sensor, *(squeeze or ())],
                out,
                RigidObject(
                    name=rigid_object or f"a rigid {rigid.value}", shape=rigid.value, size_mm=size_mm
                ),
                words=trace_words(columns, units, sheet),
                today=datetime.datetime.now(tz=datetime.UTC).date(),
                report=report,
            )
        else:
            said = calibrate_sensor(sensor, out, presses, report=report)
    except TactileFailure as reason:
        typer.echo(f"drupe: {about(sensor, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; nothing was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for line in said:
        typer.echo(line)
    typer.echo(f"wrote {out}")
