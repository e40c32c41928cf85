"""`drupe new`."""

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from pipeline.commands.endings import exit_when_interrupted
from pipeline.safe_start import elsewhere

DAY = "%Y-%m-%d"


def new(
    folder: Annotated[Path, Argument(metavar="DIR", help="The folder for the new batch.")],
    photos: Annotated[
        list[Path] | None,
        Option(
            "--photos",
            metavar="FOLDER",
            help="Photos of one fruit, or a folder with one subfolder per fruit. Repeat the option "
            "for more folders.",
            show_default="required without --like",
        ),
    ] = None,
    category: Annotated[
        str | None, Option(help="Kind of fruit.", show_default="nectarine, or that of --like")
    ] = None,
    like: Annotated[
        Path | None,
        Option(
            "--like", metavar="BATCH", help="Take classes, sensor and other settings from an earlier batch."
        ),
    ] = None,
    lot: Annotated[str | None, Option(help="The lot, for report and history.")] = None,
    cultivar: Annotated[str | None, Option(help="The cultivar, for report and history.")] = None,
    harvest_date: Annotated[
        datetime | None,
        Option("--harvest-date", formats=[DAY], metavar="YYYY-MM-DD", help="The day of the harvest."),
    ] = None,
    measured_on: Annotated[
        datetime | None,
        Option(
            "--measured-on",
            formats=[DAY],
            metavar="YYYY-MM-DD",
            help="The day of the grasps, for the history.",
            show_default="the day of the first grading",
        ),
    ] = None,
) -> None:
    """Create a batch from folders of photos: batch.toml with every key, fruits.csv, and a folder per fruit.

    --like takes the settings of an earlier batch, its mat and the files that they name (rig, pit, category),
    and its own columns of fruits.csv. What belongs to that day stays behind: lot, dates, pulp temperature,
    notes and confirmed effects. Give lot and dates of the new day as options, or write them into batch.toml.

    The folder's name becomes the fruit's id. drupe copies photos, fruit.ply, pit.ply and recordings (*.h5,
    in the folder or its grasps/). Your own folders do not change. At the end drupe lists missing inputs.

    Exit status: 0 created; 1 internal error; 2 usage or unusable folders; 130 interrupted.

    Without --photos the batch has no fruit yet, and `drupe check` ends with exit status 2 until you add some.

    Example: drupe new tuesday --like monday --lot H-08 --harvest-date 2026-08-13 --photos ~/pictures/tuesday
    """
    with elsewhere():
        from pipeline.batch.new_batch import make_batch
    stated = {
        "category": category,
        "cultivar": cultivar,
        "lot": lot,
        "harvest_date": None if harvest_date is None else harvest_date.date(),
        "measured_on": None if measured_on is None else measured_on.date(),
    }
    with exit_when_interrupted("; drupe wrote no file"):
        made = make_batch(folder, photos or [], stated=stated, like=like)
    pictures = sum(len(fruit.photos) for fruit in made.fruits)
    recordings = sum(len(fruit.recordings) for fruit in made.fruits)
    typer.echo(f"{made.root}: {len(made.fruits)} fruit, {pictures} photos, {recordings} recordings")
    for sentence in made.missing:
        typer.echo(f"missing: {sentence}.")
    if made.fruits:
        typer.echo(f"next: run `drupe check {made.root}` to find problems, then `drupe grade {made.root}`")
    else:
        typer.echo(f"next: add fruit, then run `drupe check {made.root}`; or run `drupe watch {made.root}`")
