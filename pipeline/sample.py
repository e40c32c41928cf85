"""`drupe sample`: the shipped batches, and new ones from a seed."""

import tempfile
from pathlib import Path

from rich.console import Console

from pipeline.problem import BatchRefused, Problem


def write_sample(
    folder: Path, *, name: str, seed: int | None, fruits: int, photos: bool, console: Console
) -> None:
    """Writes a shipped batch, or generates one; raises BatchRefused where the name or an extra is missing."""
    if seed is None:
        from samples.shipped import shipped_batches, write_shipped

        known = shipped_batches()
        if name not in known:
            raise BatchRefused(
                [Problem(f"--name {name}", f"no such shipped batch; there are: {', '.join(known)}.")]
            )
        write_shipped(name, folder)
        return
    from samples.batch import SampleFailure, write_batch

    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as beside:
            write_batch(
                Path(beside) / "batch",
                seed=seed,
                fruits=fruits,
                photos=photos,
                progress=lambda line: console.print(line, highlight=False, markup=False),
            )
            if folder.exists():
                folder.rmdir()
            (Path(beside) / "batch").rename(folder)
    except SampleFailure as failure:
        raise BatchRefused([Problem(str(folder), str(failure))]) from None
