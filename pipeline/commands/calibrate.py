"""`drupe calibrate`."""

import datetime
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from pipeline.commands.endings import exit_when_interrupted, exit_when_refused, say_written
from pipeline.commands.shared_options import ColumnsOption, SheetOption, UnitsOption
from pipeline.safe_start import elsewhere


def calibrate(
    sensor: Annotated[
        Path,
        Argument(
            metavar="SENSOR.toml|SQUEEZE",
            help="The sensor's description, complete or not. With --rigid: a recording of a squeeze.",
        ),
    ],
    out: Annotated[Path, Argument(metavar="OUT.toml", help="The description file to write.")],
    load_cell: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="A raw press on a load cell: grasp.toml, frames, and log.csv with fx_N, fy_N and fz_N.",
        ),
    ] = None,
    rigid: Annotated[
        Literal["ball", "block"] | None,
        Option(help="Calibrate a rig instead of a sensor; this is the shape of the rigid object."),
    ] = None,
    size_mm: Annotated[
        float | None,
        Option(min=0.1, max=1000, help="Diameter of the rigid ball, or thickness of the block, in mm."),
    ] = None,
    rigid_object: Annotated[
        str | None,
        Option("--object", metavar="WORDS", help="Description of the rigid object, stored in OUT.toml."),
    ] = None,
    squeeze: Annotated[
        list[Path] | None,
        Option(
            metavar="FILE", help="Another squeeze of the same object. Repeat the option for more squeezes."
        ),
    ] = None,
    columns: ColumnsOption = None,
    units: UnitsOption = None,
    sheet: SheetOption = None,
) -> None:
    """Calibrate a sensor from a press, or measure the compliance of a rig.

    For the modulus of a sensor's gel, give a press on a load cell (--load-cell).

    For a rig, give --rigid, --size-mm and recordings of squeezes of a rigid object. OUT.toml then holds the
    rig's own travel as a function of force. Use it with drupe convert --rig, or with rig = "OUT.toml" in
    batch.toml.

    Exit status: 0 written; 1 internal error; 2 usage; 3 unusable press; 130 interrupted.

    Example: drupe calibrate squeeze.csv rig.toml --rigid ball --size-mm 40
    """
    of_rigs = size_mm, rigid_object, squeeze, columns, units, sheet
    if rigid is None and any(of_rigs):
        raise typer.BadParameter(
            "The options --size-mm, --object, --squeeze, --columns, --units and --sheet calibrate a "
            "rig; add --rigid ball or --rigid block."
        )
    if rigid is not None and (size_mm is None or load_cell is not None):
        raise typer.BadParameter(
            "--rigid calibrates a rig and needs --size-mm. Remove --load-cell, which calibrates a sensor."
        )
    with elsewhere():
        from pipeline.recordings.rig_calibration import RigidObject, calibrate_rig
        from pipeline.recordings.sensor_calibration import calibrate as calibrate_sensor
        from pipeline.recordings.trace_options import trace_words
        from pipeline.run.progress import StageLines
        from tactile.tactile_failure import TactileFailure

    report = StageLines().stage
    today = datetime.datetime.now(tz=datetime.UTC).date()
    with exit_when_interrupted("; drupe wrote no file"), exit_when_refused(sensor, TactileFailure):
        if rigid is not None and size_mm is not None:
            said = calibrate_rig(
                [sensor, *(squeeze or ())],
                out,
                RigidObject(name=rigid_object or f"a rigid {rigid}", shape=rigid, size_mm=size_mm),
                words=trace_words(columns, units, sheet),
                today=today,
                report=report,
            )
        else:
            said = calibrate_sensor(sensor, out, load_cell, today=today, report=report)
    say_written(said, out)
