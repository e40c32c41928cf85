"""Page of the history: one HTML file that needs no network."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from reports.charts import control_chart
from reports.history_charts import characteristic_chart, firmness_chart, lots_chart, softening_chart
from reports.history_entries import HistoryEntry
from reports.html_templates import charted_page
from reports.language import ENGLISH, LANGUAGES, say, spoken
from reports.messages import in_language
from reports.words import category_name, number

TITLE = "History of graded batches"


def history_html(history: HistoryEntry, *, language: str = ENGLISH) -> str:
    """The whole page; the same entry gives the same text. It escapes all text of the batches. `language`: one
    of reports.language.LANGUAGES.
    """
    with spoken(language):
        named = partial(_named, dict(sorted(_groups(history), key=lambda names: -len(names[0]))))
        return charted_page(
            "history",
            control_chart=control_chart,
            softening_chart=softening_chart,
            lots_chart=partial(lots_chart, named=named),
            characteristic_chart=characteristic_chart,
            firmness_chart=firmness_chart,
            history=in_language(history),
            interval=_interval,
            made=f"{history.made_utc:%Y-%m-%d %H:%M} UTC",
            named=named,
            on_day=_on_day,
            title=say(TITLE),
        )


def page_titles() -> Iterator[str]:
    """The page's title in each language, by which drupe recognises a page of an earlier run."""
    for language in LANGUAGES:
        with spoken(language):
            yield f"<title>{say(TITLE)}</title>"


def _groups(history: HistoryEntry) -> Iterator[tuple[str, str]]:
    """Category and cultivar of each lot, in English and in the language in force."""
    for series in history.series:
        for_reader = " ".join(filter(None, (category_name(series.category), series.cultivar)))
        yield series.group, for_reader


def _named(groups: dict[str, str], text: str) -> str:
    """A text of category, cultivar, lot, day and size in English, with these in the language in force.

    >>> with spoken("de"):
    ...     _named({"plum Jojo": "Pflaume Jojo"}, "plum Jojo, lot 7, 2026-08-14")
    'Pflaume Jojo, Los 7, 2026-08-14'
    """
    for group, translated in groups.items():
        if text == group or text.startswith(f"{group}, "):
            rest = text.removeprefix(group)
            if rest.startswith(", lot "):
                rest = f", {say('lot')} {rest.removeprefix(', lot ')}"
            elif rest.startswith(", without a lot"):
                rest = f", {say('without a lot')}{rest.removeprefix(', without a lot')}"
            head, comma, size = rest.rpartition(", size ")
            if comma:
                rest = f"{head}, {say('size')} {say('not stated') if size == 'not stated' else size}"
            return f"{translated}{rest}"
    return text


def _on_day(text: str) -> str:
    """A lot and its day, as in `DifferenceEntry`."""
    nameless = "without a lot ("
    return f"{say('without a lot')} ({text.removeprefix(nameless)}" if text.startswith(nameless) else text


def _interval(value: float, low: float, high: float) -> str:
    """A value with its interval in brackets."""
    return f"{number(value)} ({say('{low} to {high}', low=number(low), high=number(high))})"
