"""The page of a history: one HTML file that shows all it holds, with no network and no scripts."""

from __future__ import annotations

from reports.charts_batch import control_chart
from reports.history_charts import lots_chart, softening_chart
from reports.history_entries import HistoryEntry
from reports.html_templates import page_environment
from reports.quality_charts import characteristic_chart, firmness_chart

PAGE_TITLE = "History of graded batches"
"""By which a page of an earlier run is known."""


def history_html(history: HistoryEntry) -> str:
    """The whole page, the same text for the same entry; all text of the batches is escaped."""
    environment = page_environment()
    environment.filters |= {
        "control_chart": control_chart,
        "softening_chart": softening_chart,
        "lots_chart": lots_chart,
        "characteristic_chart": characteristic_chart,
        "firmness_chart": firmness_chart,
    }
    return environment.get_template("templates/history.html.j2").render(
        history=history, made=f"{history.made_utc:%Y-%m-%d %H:%M} UTC", title=PAGE_TITLE
    )
