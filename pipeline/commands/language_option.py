"""The language of pages, the same option of every command that writes one."""

from typing import Annotated

import typer

from pipeline.problem import refused
from reports.language import LANGUAGES, of_environment

LanguageOption = Annotated[
    str | None,
    typer.Option(
        "--lang",
        metavar="LANGUAGE",
        help=f"Language of the page: {', '.join(LANGUAGES)}.",
        show_default="from the locale, otherwise en",
    ),
]


def chosen_language(asked: str | None) -> str:
    """The language asked for, else the environment's; raises BatchRefused for one that is not known."""
    if asked is None:
        return of_environment()
    if asked not in LANGUAGES:
        sentence = f'found "{asked}", expected one of {", ".join(LANGUAGES)}.'
        raise refused("--lang", sentence)
    return asked
