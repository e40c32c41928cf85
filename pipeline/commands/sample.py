"""`drupe sample`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pipeline.commands.endings import said_when_interrupted
from pipeline.problem import BatchRefused, Problem
from pipeline.safe_start import elsewhere


def sample(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder that does not exist yet, or is empty.")
    ],
    name: Annotated[str, typer.Option(help="Which shipped batch.")] = "nectarines",
    seed: Annotated[
        int | None, typer.Option(min=0, help="Generate new fruit from this seed instead of the shipped ones.")
    ] = None,
    fruits: Annotated[
        int | None,
        typer.Option(min=1, max=500, help="How many fruit to generate.", show_default="4"),
    ] = None,
    photos: Annotated[
        bool, typer.Option(help="Render photos (needs the extra [samples]); without: ready meshes.")
    ] = True,
) -> None:
    """Write a synthetic batch with known answers (answers.json): a shipped one, or new from a seed."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BatchRefused([Problem(str(folder), "is not empty; give a folder that does not exist yet.")])
    if seed is None and (fruits is not None or not photos):
        raise BatchRefused(
            [Problem("sample", "--fruits and --no-photos are for new fruit; give a --seed too.")]
        )
    with elsewhere():
        from pipeline.batch.sample_batches import write_sample
    with said_when_interrupted("; nothing was written"):
        write_sample(
            folder, name=name, seed=seed, fruits=fruits or 4, photos=photos, console=Console(stderr=True)
        )
    typer.echo(f"wrote {folder}; grade it with: drupe grade {folder}")
