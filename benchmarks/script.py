"""A benchmark as a command: its options are the arguments of its `main`."""

from collections.abc import Callable
from functools import wraps
from typing import Literal

import typer

Half = Literal["even", "odd", "all"]
"""Of data sets by their numbers: even ones were for development, odd ones are held out."""


def in_half(number: int, half: Half) -> bool:
    """Whether the data set of this number belongs to it."""
    return half == "all" or number % 2 == (half == "odd")


def run(main: Callable[..., int | None]) -> None:
    """Calls `main` with what the command line says, and ends with the status that it returns.

    `--help` shows the script's docstring.
    """

    @wraps(main)
    def command(**options: object) -> None:
        raise typer.Exit(main(**options) or 0)

    paragraphs = main.__globals__["__doc__"].split("\n\n")
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    app.command(help="\n\n".join(f"\b\n{paragraph}" for paragraph in paragraphs))(command)
    app()
