"""A benchmark as commands: their options are the arguments of its functions."""

from collections.abc import Callable
from functools import wraps
from typing import Literal

import typer

Half = Literal["even", "odd", "all"]
"""Of data sets by their numbers: even ones were for development, odd ones are held out."""


def in_half(number: int, half: Half) -> bool:
    """Whether the data set of this number belongs to it."""
    return half == "all" or number % 2 == (half == "odd")


def run(*commands: Callable[..., int | None]) -> None:
    """Calls the command that the command line names, or the only one, and ends with the status it returns.

    `--help` shows the script's docstring.
    """
    paragraphs = commands[0].__globals__["__doc__"].split("\n\n")
    words = "\n\n".join(f"\b\n{paragraph}" for paragraph in paragraphs)
    app = typer.Typer(help=words, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    for command in commands:
        app.command(help=words if len(commands) == 1 else None)(_with_status(command))
    app()


def _with_status(command: Callable[..., int | None]) -> Callable[..., None]:
    @wraps(command)
    def called(**options: object) -> None:
        raise typer.Exit(command(**options) or 0)

    return called
