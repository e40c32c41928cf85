"""`drupe sensor`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.endings import about, said_when_interrupted
from pipeline.exit_status import UNUSABLE
from pipeline.safe_start import elsewhere


def sensor(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A sensor by name; without one they are listed.")
    ] = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="[OUT.toml]", help="The description to write.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A picture of the untouched gel, as the recordings' frames are."),
    ] = None,
    pitch_mm: Annotated[
        tuple[float, float] | None, typer.Option(metavar="X Y", help="Distance of dots along x and y.")
    ] = None,
    rows: Annotated[int | None, typer.Option(min=2, max=200, help="Rows of dots on the gel.")] = None,
    columns: Annotated[int | None, typer.Option(min=2, max=200, help="Columns of dots on the gel.")] = None,
    thickness_mm: Annotated[float | None, typer.Option(min=0.1, max=50, help="Of the gel.")] = None,
    gel_modulus_MPa: Annotated[
        float | None, typer.Option("--E-MPa", min=1e-3, max=100, help="Young's modulus of the gel.")
    ] = None,
    distance_mm: Annotated[
        float | None, typer.Option(min=1, max=500, help="From the gel's face to the camera's lens.")
    ] = None,
    known_to: Annotated[
        float, typer.Option(min=0.001, max=1, help="Relative standard deviation of what is given here.")
    ] = 0.1,
) -> None:
    """Describe a sensor as it is sold: what is published of it, and its camera from a picture of the dots.

    Without a NAME the sensors are listed, with what has to be given. Every value's source and spread stands
    in the description, and the spread of force and displacement goes into E. Exit status: 0 written, 1
    internal error, 2 usage, 3 the picture cannot be used, 130 interrupted.
    """
    with elsewhere():
        from pipeline.recordings.sensor_from_model import shipped, unknown_of, write_sensor
        from tactile.tactile_failure import TactileFailure

    if name is None:
        for model in shipped():
            typer.echo(f"{model.key}: {model.name}. {unknown_of(model)}".rstrip())
        return
    if out is None:
        raise typer.BadParameter("give the description to write, OUT.toml.")
    given = {
        "pitch_mm": pitch_mm,
        "thickness_mm": None if thickness_mm is None else (thickness_mm,),
        "E_MPa": None if gel_modulus_MPa is None else (gel_modulus_MPa,),
        "distance_mm": None if distance_mm is None else (distance_mm,),
    }
    try:
        with said_when_interrupted(""):
            said = write_sensor(
                name,
                out,
                picture=picture,
                given={key: value for key, value in given.items() if value is not None},
                known_to=known_to,
                grid=(rows, columns),
            )
    except TactileFailure as reason:
        typer.echo(f"drupe: {about(picture or Path(name), reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None
    for line in said:
        typer.echo(line)
    typer.echo(f"wrote {out}")
