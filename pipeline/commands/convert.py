"""`drupe convert`."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from pipeline.commands.endings import exit_when_interrupted, exit_when_refused
from pipeline.commands.shared_options import ColumnsOption, SheetOption, UnitsOption
from pipeline.exit_status import DOUBTED, UNUSABLE
from pipeline.safe_start import elsewhere


def convert(
    source: Annotated[
        Path,
        Argument(
            metavar="SOURCE",
            help="A raw grasp (a folder with grasp.toml), Tac3D arrays, or a .npz. Or a "
            "ROS 2 bag (.mcap), or a table (.csv, .txt, .tsv, .xls, .xlsx). With --robot also a recording.",
        ),
    ],
    out: Annotated[Path, Argument(metavar="OUT.h5", help="The recording to write.")],
    sensor: Annotated[
        Path | None, Option(metavar="FILE", help="The sensor's description, used for every pad.")
    ] = None,
    fruit: Annotated[
        str, Option(metavar="ID", help="The fruit's id, if SOURCE does not state it.")
    ] = "unknown",
    category: Annotated[str, Option(help="Kind of fruit, if SOURCE does not state it.")] = "unknown",
    indenter: Annotated[
        Literal["ball", "flat", "plate", "plates"] | None,
        Option(help="Shape of the indenter of a bare load cell."),
    ] = None,
    radius_mm: Annotated[float | None, Option(min=0.001, help="Radius of the ball or punch, in mm.")] = None,
    thickness_mm: Annotated[
        float | None,
        Option(
            min=0.1,
            max=200,
            help="Thickness in mm of a slab on a rigid base under a ball or "
            "punch. Default: a thick specimen.",
        ),
    ] = None,
    specimen: Annotated[
        Literal["cylinder", "fruit"] | None, Option(help="The specimen between the plates.")
    ] = None,
    height_mm: Annotated[
        float | None, Option(min=0.1, max=500, help="Height in mm of the unloaded cylinder between plates.")
    ] = None,
    diameter_mm: Annotated[
        float | None, Option(min=0.1, max=500, help="Diameter in mm of the unloaded cylinder between plates.")
    ] = None,
    ends: Annotated[
        Literal["bonded", "lubricated"] | None,
        Option(
            help="Ends of the cylinder: bonded (glued or rough plates) or lubricated (oiled plates). "
            "Without it drupe estimates them from the curve, and the error bar of E is wider."
        ),
    ] = None,
    diameters_mm: Annotated[
        tuple[float, float, float] | None,
        Option(metavar="A B C", help="The three diameters in mm of the fruit between plates."),
    ] = None,
    axis: Annotated[
        Literal["a", "b", "c"] | None, Option(help="The diameter of the fruit that lies between the plates.")
    ] = None,
    pit_share: Annotated[
        float | None,
        Option(
            min=0,
            max=0.65,
            help="Diameter of the pit divided by the diameter of the fruit; 0 for "
            "no pit. Default: the category's value.",
        ),
    ] = None,
    columns: ColumnsOption = None,
    units: UnitsOption = None,
    sheet: SheetOption = None,
    run: Annotated[
        str | None,
        Option(
            metavar="N|all",
            help="Number of the run to read from a table with several runs, from 1. 'all' writes each usable "
            "run to OUT-1.h5, OUT-2.h5, …; exit status 3 if a run is unusable.",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="The rig's description from drupe calibrate --rigid. drupe "
            "subtracts the rig's compliance from the travel.",
        ),
    ] = None,
    robot: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="The robot's description from drupe robot. It gives the recording its pad poses, in the "
            "mat's frame.",
        ),
    ] = None,
    flange: Annotated[
        Path | None,
        Option(metavar="FILE", help="A table of the flange's poses during the grasp, for --robot."),
    ] = None,
    topics: Annotated[
        Path | None, Option(metavar="FILE", help="The names of the topics of a ROS 2 bag, in TOML.")
    ] = None,
    jaws_centre_mm: Annotated[
        tuple[float, float, float] | None,
        Option(
            metavar="X Y Z",
            help="For a grasp without poses: the point between the jaws, in the fruit's frame, in mm. "
            "drupe computes the poses from the aperture.",
        ),
    ] = None,
    closing: Annotated[
        tuple[float, float, float] | None,
        Option(metavar="X Y Z", help="Direction from the left jaw to the right jaw. Default: 1 0 0."),
    ] = None,
    up: Annotated[
        tuple[float, float, float] | None,
        Option(metavar="X Y Z", help="Direction of both pads' y axis. Default: 0 0 1."),
    ] = None,
) -> None:
    """Convert gel frames, tables or other formats to a recording for grade and explain.

    Notes report lost frames, torn markers, clock offsets and similar faults. drupe also runs the checks of
    `drupe check` that need no fruit. OUT.h5 appears only when it is complete.

    Exit status: 0 written; 1 internal error; 2 usage; 3 unusable SOURCE, or any run of it, or refused OUT.h5;
    4 written but E will be in doubt; 130 interrupted. `drupe grade` does not accept a refused OUT.h5.

    Example: drupe convert press.csv fruit7.h5 --indenter ball --radius-mm 4
    """
    with elsewhere():
        from pipeline.recordings.conversion import ConvertRequest, convert_runs
        from pipeline.recordings.trace_options import ALL_RUNS, trace_words
        from pipeline.run.progress import StageLines
        from tactile.jaw_poses import Jaws
        from tactile.readers.specimen import PressedSpecimen
        from tactile.tactile_failure import TactileFailure

    if (robot is None) != (flange is None):
        raise typer.BadParameter("--robot and --flange belong together; give both or none.")
    if jaws_centre_mm is None and (closing or up):
        raise typer.BadParameter("--closing and --up need --jaws-centre-mm.")
    if jaws_centre_mm is not None and robot is not None:
        raise typer.BadParameter("--jaws-centre-mm and --robot both give poses; remove one of them.")
    wanted = ConvertRequest(
        sensor=sensor,
        fruit_id=fruit,
        category=category,
        indenter="plate"
        if indenter == "plates"
        else indenter,  # one plate against a rigid base is two plates
        radius_mm=radius_mm,
        specimen=PressedSpecimen(
            kind=specimen,
            thickness_mm=thickness_mm,
            height_mm=height_mm,
            diameter_mm=diameter_mm,
            ends=ends,
            diameters_mm=diameters_mm,
            axis=axis,
            pit_share=pit_share,
        ),
        trace=trace_words(columns, units, sheet, run),
        all_runs=run == ALL_RUNS,
        rig=rig,
        robot=robot,
        flange=flange,
        topics=topics,
        jaws=None
        if jaws_centre_mm is None
        else Jaws(centre_mm=jaws_centre_mm, closing=closing or (1.0, 0.0, 0.0), up=up or (0.0, 0.0, 1.0)),
    )
    kept = "; files of finished runs, if any, are complete" if wanted.all_runs else "; drupe wrote no file"
    with exit_when_interrupted(kept), exit_when_refused(source, TactileFailure):
        runs = convert_runs(source, out, wanted, report=StageLines().stage)
    unusable = doubted = False
    for path, done in runs:
        if isinstance(done, TactileFailure):
            unusable = True
            typer.echo(f"drupe: did not write {path}: {done}", err=True)
            continue
        for note in done.notes:
            typer.echo(f"note: {note}")
        for doubt in done.doubts:
            typer.echo(f"E will be in doubt: {doubt}", err=True)
        for finding in done.refused:
            typer.echo(f"drupe grade will refuse this recording: {finding}", err=True)
        typer.echo(f"wrote {path}")
        unusable, doubted = unusable or bool(done.refused), doubted or bool(done.doubts)
    if unusable or doubted:
        raise typer.Exit(UNUSABLE if unusable else DOUBTED)
