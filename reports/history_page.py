"""Page of the history: one HTML file that needs no network."""

from __future__ import annotations

from collections.abc import Iterator

from reports.charts import control_chart
from reports.history_charts import characteristic_chart, firmness_chart, lots_chart, softening_chart
from reports.history_entries import HistoryEntry
from reports.html_templates import charted_page
from reports.language import ENGLISH, LANGUAGES, say, spoken
from reports.messages import in_language
from reports.words import number

TITLE = "History of graded batches"


def history_html(history: HistoryEntry, *, language: str = ENGLISH) -> str:
    """The whole page; the same entry gives the same text. It escapes all text of the batches. `language`: one
    of reports.language.LANGUAGES.
    """
    with spoken(language):
        return charted_page(
            "history",
            control_chart=control_chart,
            softening_chart=softening_chart,
            lots_chart=lots_chart,
            characteristic_chart=characteristic_chart,
            firmness_chart=firmness_chart,
            history=in_language(history),
            interval=_interval,
            made=f"{history.made_utc:%Y-%m-%d %H:%M} UTC",
            title=say(TITLE),
        )


def page_titles() -> Iterator[str]:
    """The page's title in each language, by which drupe recognises a page of an earlier run."""
    for language in LANGUAGES:
        with spoken(language):
            yield f"<title>{say(TITLE)}</title>"


def _interval(value: float, low: float, high: float) -> str:
    """A value with its interval in brackets."""
    return f"{number(value)} ({say('{low} to {high}', low=number(low), high=number(high))})"
