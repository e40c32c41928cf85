"""`drupe sample`."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from typer import Argument, Option

from pipeline.commands.endings import exit_when_interrupted
from pipeline.files.whole_file import NotWritten
from pipeline.problem import refused
from pipeline.safe_start import elsewhere


def sample(
    folder: Annotated[Path, Argument(metavar="DIR", help="A new or empty folder for the batch.")],
    name: Annotated[str, Option(help="Name of the shipped batch.")] = "nectarines",
    seed: Annotated[
        int | None,
        Option(min=0, help="Generate new fruit from this random seed instead of copying the shipped batch."),
    ] = None,
    fruits: Annotated[
        int | None, Option(min=1, max=500, help="Number of fruit to generate.", show_default="4")
    ] = None,
    photos: Annotated[
        bool,
        Option(help="Render photos (needs the extra drupe[samples]). Without photos, drupe writes meshes."),
    ] = True,
) -> None:
    """Write a synthetic batch with known answers: a shipped batch, or new fruit from a random seed.

    True moduli are in answers.json.

    Exit status: 0 written; 1 internal error; 2 usage; 130 interrupted.

    Example: drupe sample demo --seed 7 --fruits 6
    """
    if folder.exists() and not folder.is_dir():
        raise refused(folder, "is a file; give a new folder.")
    if folder.exists() and any(folder.iterdir()):
        raise refused(folder, "is not empty; give a new folder.")
    if seed is None and (fruits is not None or not photos):
        raise refused("sample", "--fruits and --no-photos apply to new fruit only; add --seed.")
    with elsewhere():
        from pipeline.batch.scratch import moved_in, scratch
        from pipeline.run.progress import say
        from samples.sample_failure import SampleFailure
        from samples.shipped import shipped_batches, write_shipped

    target, console = folder.resolve(), Console(stderr=True)
    with exit_when_interrupted("; drupe wrote no file"), scratch(near=target) as unfinished:
        try:
            if seed is None:
                if name not in (known := shipped_batches()):
                    sentence = f"drupe ships no such batch; known: {', '.join(known)}."
                    raise refused(f"--name {name}", sentence)
                write_shipped(name, unfinished / "batch")
            else:
                with elsewhere():
                    from samples.sample_batch import write_batch

                progress = partial(say, console)
                write_batch(
                    unfinished / "batch", seed=seed, fruits=fruits or 4, photos=photos, progress=progress
                )
            moved_in(unfinished / "batch", target)
        except SampleFailure as failure:
            raise refused(folder, str(failure)) from None
        except OSError as error:
            raise NotWritten(folder, error) from error
    typer.echo(f"wrote {folder}; grade it with: drupe grade {folder}")
