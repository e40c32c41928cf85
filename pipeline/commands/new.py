"""`drupe new`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.endings import said_when_interrupted
from pipeline.safe_start import elsewhere


def new(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The batch to make; a new folder.")],
    photos: Annotated[
        list[Path],
        typer.Option(
            "--photos",
            metavar="FOLDER",
            help="Photos of one fruit, or a folder with one folder per fruit; several times if need be.",
        ),
    ],
    category: Annotated[str, typer.Option(help="What the fruit are.")] = "nectarine",
) -> None:
    """Make a batch from folders of photos: batch.toml with every key, fruits.csv, and a folder per fruit.

    A fruit is named as its folder is. Photos, fruit.ply, pit.ply and recordings (*.h5, in the folder or its
    grasps/) are copied; nothing is changed where they lie. What is still missing is said at the end.
    Example: drupe new monday --photos ~/pictures/2026-08-14 --category peach
    """
    with elsewhere():
        from pipeline.batch.new_batch import make_batch
    with said_when_interrupted("; nothing was made"):
        made = make_batch(folder, photos, category=category)
    pictures = sum(len(one.photos) for one in made.fruits)
    recordings = sum(len(one.recordings) for one in made.fruits)
    typer.echo(f"{made.root}: {len(made.fruits)} fruit, {pictures} photos, {recordings} recordings")
    for sentence in made.missing:
        typer.echo(f"missing: {sentence}.")
    typer.echo(f"next: `drupe check {made.root}` says what is wrong, `drupe grade {made.root}` grades")
