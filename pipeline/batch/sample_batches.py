"""`drupe sample`: the shipped batches, and new ones from a seed."""

from pathlib import Path

from rich.console import Console

from pipeline.batch.scratch import moved_in, scratch
from pipeline.files.whole_file import NotWritten
from pipeline.problem import refused


def write_sample(
    folder: Path, *, name: str, seed: int | None, fruits: int, photos: bool, console: Console
) -> None:
    """Writes a shipped batch, or generates one; raises BatchRefused where the name or an extra is missing.

    `folder` is empty or not there yet; a new one appears whole or not at all.
    """
    from samples.sample_failure import SampleFailure

    target = folder.resolve()
    with scratch(near=target) as unfinished:
        try:
            if seed is None:
                from samples.shipped import shipped_batches, write_shipped

                if name not in (known := shipped_batches()):
                    sentence = f"drupe ships no such batch; known: {', '.join(known)}."
                    raise refused(f"--name {name}", sentence)
                write_shipped(name, unfinished / "batch")
            else:
                from samples.sample_batch import write_batch

                write_batch(
                    unfinished / "batch",
                    seed=seed,
                    fruits=fruits,
                    photos=photos,
                    progress=lambda line: console.print(line, highlight=False, markup=False),
                )
            moved_in(unfinished / "batch", target)
        except SampleFailure as failure:
            raise refused(folder, str(failure)) from None
        except OSError as error:
            raise NotWritten(folder, error) from error
