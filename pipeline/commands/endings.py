"""What commands require of the machine, and how they end: interrupted, with a refused input, with a file."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from pipeline.exit_status import INTERRUPTED, UNUSABLE
from pipeline.problem import BatchRefused, Problem
from pipeline.system_libraries import missing_libraries


def require_libraries() -> None:
    """Raises BatchRefused with every missing system library that native wheels load."""
    if missing := missing_libraries():
        raise BatchRefused([Problem("this machine", sentence) for sentence in missing])


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def exit_when_interrupted(message_end: str) -> Iterator[None]:
    """Converts Ctrl-C in the block to exit status 130 and a message that ends with `message_end`."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"drupe: interrupted{message_end}", err=True)
        raise typer.Exit(INTERRUPTED) from None


@contextmanager
def exit_when_refused(path: Path, *failures: type[Exception]) -> Iterator[None]:
    """Converts `failures` in the block to exit status 3 and a message that names the input `path`."""
    try:
        yield
    except failures as reason:
        typer.echo(f"drupe: {about(path, reason)}", err=True)
        raise typer.Exit(UNUSABLE) from None


def say_written(sentences: Iterable[str], out: Path) -> None:
    """Prints the sentences, then the line that names the written file `out`."""
    for sentence in sentences:
        typer.echo(sentence)
    typer.echo(f"wrote {out}")


def about(path: Path, reason: Exception) -> str:
    """The reason, prefixed with the path unless it already starts with it."""
    said = str(reason)
    last_two = str(Path(*path.parts[-2:]))
    named = [f"{name}{mark}" for name in (str(path), last_two, path.name) if name for mark in ":/ "]
    return said if said.startswith(tuple(named)) else f"{path}: {said}"
