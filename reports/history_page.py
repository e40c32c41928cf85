"""Page of the history: one HTML file that needs no network."""

from __future__ import annotations

from reports.charts import control_chart
from reports.history_charts import characteristic_chart, firmness_chart, lots_chart, softening_chart
from reports.history_entries import HistoryEntry
from reports.html_templates import charted_page

PAGE_TITLE = "History of graded batches"
"""drupe recognises a page of an earlier run by this title."""


def history_html(history: HistoryEntry) -> str:
    """The whole page; the same entry gives the same text. It escapes all text of the batches."""
    return charted_page(
        "history",
        control_chart=control_chart,
        softening_chart=softening_chart,
        lots_chart=lots_chart,
        characteristic_chart=characteristic_chart,
        firmness_chart=firmness_chart,
        history=history,
        made=f"{history.made_utc:%Y-%m-%d %H:%M} UTC",
        title=PAGE_TITLE,
    )
