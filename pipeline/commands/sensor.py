"""`drupe sensor`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from pipeline.commands.endings import exit_when_refused, say_written
from pipeline.safe_start import elsewhere


def sensor(
    name: Annotated[
        str | None,
        Argument(metavar="[NAME]", help="Name of the sensor. Without a name, drupe lists the known sensors."),
    ] = None,
    out: Annotated[Path | None, Argument(metavar="[OUT.toml]", help="The description file to write.")] = None,
    picture: Annotated[
        Path | None,
        Option(metavar="FILE", help="A picture of the untouched gel, at the size of the recordings' frames."),
    ] = None,
    pitch_mm: Annotated[
        tuple[float, float] | None, Option(metavar="X Y", help="Distance between dots along x and y, in mm.")
    ] = None,
    rows: Annotated[int | None, Option(min=2, max=200, help="Number of rows of dots on the gel.")] = None,
    columns: Annotated[
        int | None, Option(min=2, max=200, help="Number of columns of dots on the gel.")
    ] = None,
    thickness_mm: Annotated[
        float | None, Option(min=0.1, max=50, help="Thickness of the gel, in mm.")
    ] = None,
    gel_modulus_MPa: Annotated[
        float | None, Option("--E-MPa", min=1e-3, max=100, help="Young's modulus of the gel, in MPa.")
    ] = None,
    distance_mm: Annotated[
        float | None,
        Option(min=1, max=500, help="Distance from the gel's surface to the camera lens, in mm."),
    ] = None,
    known_to: Annotated[
        float, Option(min=0.001, max=1, help="Relative standard deviation of the values given here.")
    ] = 0.1,
) -> None:
    """Write the description of a commercial sensor from published values and a picture of its dots.

    Without NAME, drupe lists the known sensors and the values that you must give. The description states the
    source and the standard deviation of every value. The uncertainty of force and displacement enters the
    error bar of E.

    Exit status: 0 written; 1 internal error; 2 usage; 3 unusable picture; 130 interrupted.

    Example: drupe sensor
    """
    with elsewhere():
        from pipeline.recordings.sensor_from_model import shipped, unknown_of, write_sensor
        from tactile.tactile_failure import TactileFailure

    if name is None:
        for model in shipped():
            typer.echo(f"{model.key}: {model.name}. {unknown_of(model)}".rstrip())
        return
    if out is None:
        raise typer.BadParameter("Name the description file to write, for example OUT.toml.")
    given = {
        "pitch_mm": pitch_mm,
        "thickness_mm": None if thickness_mm is None else (thickness_mm,),
        "E_MPa": None if gel_modulus_MPa is None else (gel_modulus_MPa,),
        "distance_mm": None if distance_mm is None else (distance_mm,),
    }
    with exit_when_refused(picture or Path(name), TactileFailure):
        said = write_sensor(
            name,
            out,
            picture=picture,
            given={key: value for key, value in given.items() if value is not None},
            known_to=known_to,
            grid=(rows, columns),
        )
    say_written(said, out)
