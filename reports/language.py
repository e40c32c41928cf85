"""Language of a page: one file of translated sentences per language, and its decimal separator.

Code and templates are in English; `say` finds the translation in reports/words/NAME.toml. reports/messages.py
translates the sentences of other packages (warnings, doubts, failures).
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import resources

from markupsafe import Markup

ENGLISH = "en"
LANGUAGES = (ENGLISH, "de", "es")
"""Codes of ISO 639-1."""
DECIMAL_COMMA = frozenset({"de", "es"})
_in_force: ContextVar[str] = ContextVar("language", default=ENGLISH)
"""The language of the page that is being made."""


@contextmanager
def spoken(language: str) -> Iterator[None]:
    """Context in which pages are in this language. Raises ValueError for one that is not in LANGUAGES."""
    if language not in LANGUAGES:
        raise ValueError(f'found language "{language}", expected one of {", ".join(LANGUAGES)}')
    token = _in_force.set(language)
    try:
        yield
    finally:
        _in_force.reset(token)


def of_environment(environment: Mapping[str, str] = os.environ) -> str:
    """The language in the first set of LC_ALL, LC_MESSAGES and LANG if it is one of LANGUAGES; else English.

    >>> of_environment({"LANG": "de_AT.UTF-8"}), of_environment({"LANG": "C.UTF-8"}), of_environment({})
    ('de', 'en', 'en')
    """
    for name in ("LC_ALL", "LC_MESSAGES", "LANG"):
        if value := environment.get(name):
            wanted = value[:2].lower()
            return wanted if wanted in LANGUAGES else ENGLISH
    return ENGLISH


def language_in_force() -> str:
    """The language of the page that is being made."""
    return _in_force.get()


def say(text: str, **values: object) -> str:
    """Translation of an English sentence into the language in force, with `values` in its braces.

    >>> with spoken("de"):
    ...     say("{count} fruit", count=3)
    '3 Früchte'
    """
    said = _sentence(text)
    return said.format(**values) if values else said


def fruit_count(count: int) -> str:
    """The number of fruit with its noun, in the language in force.

    >>> with spoken("de"):
    ...     fruit_count(1), fruit_count(2)
    ('1 Frucht', '2 Früchte')
    """
    return say("1 fruit") if count == 1 else say("{count} fruit", count=count)


def say_html(text: str, **values: object) -> Markup:
    """As `say`, for a sentence with markup; values are escaped."""
    said = Markup(_sentence(text))  # safe: this package wrote the markup, not the batch
    return said.format(**values) if values else said


def decimals(figure: str) -> str:
    """A number with the decimal separator of the language in force.

    >>> with spoken("es"):
    ...     decimals("0.321 ± 0.012")
    '0,321 ± 0,012'
    """
    return figure.replace(".", ",") if _in_force.get() in DECIMAL_COMMA else figure


def _sentence(text: str) -> str:
    language = _in_force.get()
    return text if language == ENGLISH else words_of(language).get(text, text)


@cache
def words_of(language: str) -> Mapping[str, str]:
    """Translations by English sentence."""
    file = resources.files("reports").joinpath(f"words/{language}.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))
