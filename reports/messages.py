"""Warnings, doubts, reasons and problems in the language of a page or of the terminal.

The other packages write them in English from format strings, and records keep the English. A catalogue
(reports/words/messages-NAME.toml) maps each format string, with placeholders {0}, {1}, to its translation.
`message` finds the format string that a sentence matches, and translates the placeholders' texts likewise. A
sentence without a translation stays English. tests/reports/test_messages.py compares catalogues and code.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, lru_cache
from importlib import resources
from itertools import zip_longest
from typing import Any, NamedTuple, TypeVar

from reports.entries import BatchEntry, FruitEntry, ReferenceEntry, ScreenEntry, Suspect
from reports.explain_entries import EffectEntry, ExplainEntry
from reports.history_entries import (
    AcceptanceEntry,
    FirmnessEntry,
    GaugeEntry,
    GroupEntry,
    HistoryEntry,
    LimitEntry,
    LotDecisionEntry,
    ObjectiveSampleEntry,
    QualityEntry,
    SeriesEntry,
)
from reports.language import ENGLISH, decimals, language_in_force, say, words_of

_FIELD = re.compile(r"(?:\{\d\})+")
"""A placeholder. Adjacent ones count as one, because nothing marks where the first ends."""
_FIGURE = re.compile(r"(?!.*\d\.\d+\.\d)(?:[-+±\d./^()=% ]|MPa|[kNE]\b)*\d(?:[-+±\d./^()=% ]|MPa|[kNE]\b)*")
"""A number, a value with its deviation, a day or an equation of E; no version."""
MOST_FIGURE = 80
"""Most characters of a figure: the time of a search grows with their square."""
MOST_NAME = 300
"""Most characters before a colon that may name a recording or a file."""
_CONJUNCTIONS = frozenset({"and", "of", "or", "times"})
"""Words that do not tell drupe's sentence from a person's."""
_OWN_TEXT = frozenset({"Notes"})
"""Facts whose words a person wrote."""
_VERBATIM = re.compile(r'(?<=[`"])\{(\d)\}(?=[`"])')
"""A placeholder in quotes or backticks. Its text is a name or a key of a file, which nobody may translate."""
SENTENCES: Mapping[type, tuple[str, ...]] = {
    BatchEntry: ("fruits", "faults", "reference"),
    FruitEntry: ("screen", "reason", "smaller_error", "warnings", "doubts", "forced", "facts"),
    ReferenceEntry: ("sentences",),
    ScreenEntry: ("suspects", "why_not", "note"),
    Suspect: ("short", "advice"),
    ExplainEntry: (
        *("withheld", "doubts", "next_grasp", "p_nominal", "notes", "applied"),
        *("effects", "parameter_words", "facts"),
    ),
    EffectEntry: ("short", "meaning", "advice"),
    HistoryEntry: ("series", "alarms", "groups", "comparisons", "gauges", "quality"),
    SeriesEntry: ("softening_words", "limits", "notes"),
    LimitEntry: ("words", "tenth_words"),
    GroupEntry: ("words",),
    GaugeEntry: ("words", "components"),
    QualityEntry: ("plans", "samples", "firmness"),
    AcceptanceEntry: ("words", "risks", "decisions", "refusals"),
    LotDecisionEntry: ("verdict", "words"),
    ObjectiveSampleEntry: ("words",),
    FirmnessEntry: ("words",),
}
"""Fields of report records that hold sentences of other packages, or records with such sentences."""
_BETWEEN_NAMES = re.compile("(, | with | or | and )")
_Entry = TypeVar("_Entry", BatchEntry, ExplainEntry, HistoryEntry)


class _Template(NamedTuple):
    literal: str
    """The longest text between fields; a sentence without it does not fit."""
    pattern: re.Pattern[str]
    translation: str
    verbatim: frozenset[str]
    """Numbers of the fields that keep their text."""


def in_language(entry: _Entry) -> _Entry:
    """The record with its sentences in the language in force."""
    return entry if language_in_force() == ENGLISH else _translated(entry)


def message(text: str) -> str:
    """An English sentence in the language in force; unchanged if no catalogue has it."""
    return _message(text, language_in_force()) or text


def _translated(said: Any) -> Any:
    """A sentence, several, those of a mapping, or those of a record that SENTENCES names, in the language in
    force.
    """
    if isinstance(said, str):
        return message(said)
    if isinstance(said, tuple) and said and isinstance(said[0], str) and said[0] in _OWN_TEXT:
        return (message(said[0]), *said[1:])
    if isinstance(said, tuple):
        return tuple(map(_translated, said))
    if isinstance(said, Mapping):
        return {name: _translated(inner) for name, inner in said.items()}
    names = SENTENCES.get(type(said), ())
    return replace(said, **{name: _translated(getattr(said, name)) for name in names}) if names else said


@lru_cache(maxsize=4096)
def _message(text: str, language: str) -> str | None:
    """Translation of the text, with or without its full stop, of its sentences, or of the part after a name
    and a colon. None without a translation.
    """
    if language == ENGLISH or not text:
        return None
    if (whole := _whole(text, language)) is not None:
        return whole
    if text.endswith(".") and (open_end := _message(text[:-1], language)) is not None:
        return f"{open_end}."
    for stop in re.finditer(r"\.(?= )", text):
        first = _whole(text[: stop.end()], language) or _whole(text[: stop.start()], language)
        if first is None and _is_figure(text[: stop.start()]):
            first = decimals(text[: stop.start()])
        if first is not None:
            rest = text[stop.end() + 1 :]
            return f"{first.removesuffix('.')}. {_message(rest, language) or rest}"
    name, colon, rest = text.partition(": ")
    if colon and len(name) <= MOST_NAME and (said := _message(rest, language)) is not None:
        return f"{name}: {said}"
    return None


def _whole(text: str, language: str) -> str | None:
    """Translation by the matching template with the longest fixed text; None without a match."""
    for template in _templates(language):
        if template.literal in text and (fit := template.pattern.fullmatch(text)) is not None:
            parts = {
                name[1:]: part if name[1:] in template.verbatim else _part(part, language)
                for name, part in fit.groupdict().items()
            }
            pieces = re.split(r"\{(\d)\}", template.translation)
            return "".join(parts[piece] if k % 2 else piece for k, piece in enumerate(pieces))
    return None


def _is_figure(text: str) -> bool:
    return len(text) <= MOST_FIGURE and _FIGURE.fullmatch(text) is not None


def _part(text: str, language: str) -> str:
    if _is_figure(text):
        return decimals(text)
    return _message(text, language) or _effect_names(text, language) or text


def _effect_names(text: str, language: str) -> str | None:
    """Translation of a name that is an identifier (`thermal_drift`) or has a capital (`Thermal drift`), and
    of several names in a list (`thermal drift with slip`). None without a translation of each.
    """
    said = []
    for k, piece in enumerate(_BETWEEN_NAMES.split(text)):
        name = piece.replace("_", " ")
        words = say(piece) if k % 2 else _name(name, language) or _name(name[:1].lower() + name[1:], language)
        if not words:
            return None
        said.append(words[:1].upper() + words[1:] if piece[:1].isupper() else words)
    return "".join(said)


def _name(words: str, language: str) -> str | None:
    return _message(words, language) or words_of(language).get(words)


@cache
def _templates(language: str) -> tuple[_Template, ...]:
    known = sorted(catalogue(language).items(), key=lambda entry: -len(_FIELD.sub("", entry[0])))
    return tuple(
        _Template(
            max(_FIELD.split(english), key=len),
            _pattern(english),
            translation,
            frozenset(_VERBATIM.findall(english)),
        )
        for english, translation in known
    )


def _pattern(english: str) -> re.Pattern[str]:
    """Pattern of the texts that fit a template; of adjacent fields, the first takes all. A template without a
    word but conjunctions takes only figures.
    """
    pieces = re.split(r"\{(\d)\}(?:\{\d\})*", english)
    words = {*re.findall(r"[^\W\d_]{2,}", " ".join(pieces[0::2]))}
    what = r"[-+]?\d[\d.]*" if words <= _CONJUNCTIONS else ".*?"
    names = (f"(?P<f{number}>{what})" for number in pieces[1::2])
    text = map(re.escape, pieces[0::2])
    return re.compile(
        "".join(piece + name for piece, name in zip_longest(text, names, fillvalue="")), re.DOTALL
    )


@cache
def catalogue(language: str) -> Mapping[str, str]:
    """Translations by English template; empty for English."""
    if language == ENGLISH:
        return {}
    file = resources.files("reports").joinpath(f"words/messages-{language}.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))
