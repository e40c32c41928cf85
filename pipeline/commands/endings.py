"""How commands end: what is said of an interruption or a refused input."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from pipeline.exit_status import INTERRUPTED, UNUSABLE


@contextmanager
def said_when_interrupted(what_is_left: str) -> Iterator[None]:
    """Inside the block Ctrl-C is said, with `what_is_left` of the work, and is exit status 130."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"drupe: interrupted{what_is_left}", err=True)
        raise typer.Exit(INTERRUPTED) from None


@contextmanager
def said_when_refused(path: Path, *failures: type[Exception]) -> Iterator[None]:
    """Inside the block a failure on the input at `path` is said, and is exit status 3."""
    try:
        yield
    except failures as reason:
        typer.echo(f"drupe: {about(path, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None


def say_written(sentences: Iterable[str], out: Path) -> None:
    """Prints the sentences, and that `out` was written."""
    for sentence in sentences:
        typer.echo(sentence)
    typer.echo(f"wrote {out}")


def about(path: Path, reason: Exception) -> str:
    """The reason, with the path in front where it does not begin with it."""
    said = str(reason)
    last_two = str(Path(*path.parts[-2:]))
    named = [f"{name}{mark}" for name in (str(path), last_two, path.name) if name for mark in ":/ "]
    return said if said.startswith(tuple(named)) else f"{path}: {said}"
