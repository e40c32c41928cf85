"""`drupe calibrate`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.endings import about
from pipeline.exit_status import INTERRUPTED, UNUSABLE
from pipeline.safe_start import elsewhere


def calibrate(
    sensor: Annotated[
        Path, typer.Argument(metavar="SENSOR.toml", help="The sensor's description as far as it is known.")
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
) -> None:
    """Complete a sensor's description from presses: slopes from a ball, stiffness from a load cell.

    A ball of known radius gives a photometric sensor's look-up of slopes (written beside OUT.toml), a press
    with the machine's load cell the gel's modulus. Exit status: 0 written, 1 internal error, 2 usage, 3 a
    press cannot be used, 130 interrupted.
    """
    with elsewhere():
        from pipeline.recordings.sensor_calibration import Presses
        from pipeline.recordings.sensor_calibration import calibrate as calibrate_sensor
        from pipeline.run.progress import StageLines
        from tactile.tactile_failure import TactileFailure

    presses = Presses(ball_mm=ball_mm, reference=reference, ball=tuple(press or ()), load_cell=load_cell)
    try:
        said = calibrate_sensor(sensor, out, presses, report=StageLines(Console(stderr=True)).stage)
    except TactileFailure as reason:
        typer.echo(f"drupe: {about(sensor, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    except KeyboardInterrupt:
        typer.echo("drupe: interrupted; nothing was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for line in said:
        typer.echo(line)
    typer.echo(f"wrote {out}")
