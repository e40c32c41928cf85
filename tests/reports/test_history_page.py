"""The page of the history in a browser: names of class limits, narrow screens and accessibility."""

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest
from browser import assert_readable, chromium, require_named_cells
from test_charts import contrast, palette

from reports.history_entries import (
    AcceptanceEntry,
    DayEntry,
    DifferenceEntry,
    FirmnessEntry,
    GaugeEntry,
    GroupEntry,
    HistoryEntry,
    LimitEntry,
    LotDecisionEntry,
    LotStatistics,
    ObjectiveSampleEntry,
    QualityEntry,
    SeriesEntry,
)
from reports.history_page import history_html

pytestmark = pytest.mark.slow
TIMEOUT_MS = 120_000
"""Of each step: on a busy machine a browser starts slowly."""
WRITTEN = """
const draw = CanvasRenderingContext2D.prototype.fillText;
window.written = [];
CanvasRenderingContext2D.prototype.fillText = function (words, x, y, ...most) {
  const wide = Math.min(this.measureText(words).width, ...most);
  const left = x - { left: 0, center: wide / 2, right: wide }[this.textAlign];
  window.written.push([words, left, left + wide, y, this.canvas.width]);
  return draw.call(this, words, x, y, ...most);
};"""
"""Keeps all words that charts write: left and right end, height, and the width of the canvas."""
ROUND = """
window.round = [];
const pen = CanvasRenderingContext2D.prototype;
for (const name of ["beginPath", "arc", "fill", "stroke"]) {
  const draw = pen[name];
  pen[name] = function (...all) {
    if (name === "beginPath") this.isRound = false;
    if (name === "arc") this.isRound = true;
    if (this.isRound && name in { fill: 1, stroke: 1 })
      window.round.push([this.globalAlpha, this[`${name}Style`]]);
    return draw.apply(this, all);
  };
}"""
"""Keeps opacity and colour of every round mark."""
CUT = """() => [...document.querySelectorAll(".stacked, .stacked :is(th, td)")]
  .filter((part) => part.offsetParent && part.scrollWidth > part.clientWidth + 1)
  .map((part) => part.outerHTML)"""
"""Tables for narrow screens, or their cells, that are wider than their place."""


def day(at, E):
    single = tuple(E * np.linspace(0.8, 1.2, 9))
    return DayEntry(
        day=date(2026, 8, 1) + timedelta(days=at),
        E_MPa=E,
        E_low_MPa=0.95 * E,
        E_high_MPa=1.05 * E,
        left_out=0,
        single_E_MPa=single,
        temperature_C=None,
        statistics=LotStatistics(
            n=9, mean_MPa=E, sd_MPa=0.1 * E, percentiles_MPa=single[::2], needed=12
        ),
    )  # fmt: skip


def limit(name, E, outside=(0.0, 0.0, 0.2)):
    long = "In about 3.5 days, on 2026-08-17 (2026-08-15 to 2026-08-18, 90 %)."
    return LimitEntry(
        name=name, E_max_MPa=E, words=long, tenth_words=long, share_below=0.0, outside=outside
    )  # fmt: skip


@pytest.fixture(scope="module")
def history():
    """Two lots with marks on their last day at the height of the class limits, and a plan."""
    lots = tuple(
        SeriesEntry(
            category="nectarine",
            cultivar="Big Top",
            lot=lot,
            days=(day(0, 0.9), day(5, 0.6)),
            softening_words="No softening is visible.",
            limits=(limit("ready to eat", 0.5), limit("ready to buy", 0.51), limit("turning", 0.7)),
        )
        for lot in ("A", "B")
    )
    last = lots[0].days[-1].day
    difference = DifferenceEntry(
        first=replace(lots[0].name, day=last),
        second=replace(lots[1].name, day=last),
        difference_MPa=0.1,
        low_MPa=-0.1,
        high_MPa=0.3,
        p=0.4,
    )
    plan = AcceptanceEntry(
        words="Lot of 5000, AQL 4 %",
        risks="The plan accepts 95 % of lots with 4.7 % nonconforming fruit",
        class_name="ready to eat",
        aql=4.0,
        curve=np.array([[0.0, 1.0, 1.0], [4.0, 0.95, 0.96], [10.0, 0.1, 0.1]]),
        decisions=(LotDecisionEntry(name=lots[0].name, verdict="more fruit needed", words="9 " * 60),),
    )
    cheeks = tuple((f"N{k}", ((0.6, 0.02), (0.62, None))) for k in range(10))
    sample = ObjectiveSampleEntry(
        name=replace(lots[0].name, day=last, size=""), fruit=10, fruit_missing=0, cheeks_missing=(),
        words="The sample suffices", cheeks=cheeks,
    )  # fmt: skip
    E_MPa = np.linspace(0.4, 0.9, 10)
    line = np.column_stack([E_MPa, *(40 * E_MPa + more for more in (0, -3, 3))])
    firmness = FirmnessEntry(
        name=replace(lots[0].name, lot=None), plunger_mm=11.1, words="fitted", E_MPa=E_MPa,
        reading_N=40 * E_MPa, line=line,
    )  # fmt: skip
    gauge = GaugeEntry(kind="gripper", words="w.", components=(("EV", 2.0, 40.0),), biases=(("G1", 0.3),))
    return HistoryEntry(
        made_utc=datetime(2026, 8, 20, tzinfo=UTC),
        batches=4,
        series=lots,
        groups=(GroupEntry(series=lots, words="w.", rates={}, differences=(difference,)),),
        gauges=(gauge,),
        quality=QualityEntry(plans=(plan,), samples=(sample,), firmness=(firmness,)),
    )


@pytest.fixture
def shown(history, tmp_path):
    """Opens the page; fails on any message of the browser."""
    complaints = []
    with chromium() as browser:

        def show(**context):
            path = tmp_path / "history.html"
            path.write_text(history_html(history), encoding="utf-8")
            page = browser.new_context(offline=True, **context).new_page()
            page.add_init_script(WRITTEN + ROUND)
            page.set_default_timeout(TIMEOUT_MS)
            page.on("console", lambda message: complaints.append(message.text))
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.goto(path.as_uri(), timeout=TIMEOUT_MS)
            return page

        yield show
    assert complaints == []


@pytest.mark.parametrize("width", [360, 1280])
def test_names_of_class_limits_stand_beside_the_marks_and_apart(shown, history, width):
    page = shown(viewport={"width": width, "height": 800})
    edge = page.locator("figure.drawn .u-over").nth(1).evaluate(
        "(over) => over.getBoundingClientRect().right - over.closest('.uplot').getBoundingClientRect().left"
    )  # fmt: skip
    names = [limit.name for limit in history.series[0].limits]
    written = [each for each in page.evaluate("window.written") if each[0] in names][-len(names) :]
    assert sorted(words for words, *_ in written) == sorted(names)
    for words, left, right, _, canvas in written:
        assert edge <= left < right <= canvas, words
    heights = sorted(y for *_, y, _ in written)
    assert min(np.diff(heights)) >= 12  # the height of the letters, px


@pytest.mark.parametrize("width", [360, 768, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_and_cells_are_whole(shown, width, scheme):
    page = shown(viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert_readable(page, width)
    assert page.evaluate(CUT) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_single_fruit_stand_out_from_the_page(shown, scheme):
    """WCAG 2.2: contrast of at least 3 for graphics."""
    page = shown(color_scheme=scheme)
    paper = palette(scheme)["paper"]
    marks = page.evaluate("window.round")
    assert len(marks) >= 2 * 2 * 9  # two lots, two days, nine fruit
    for opacity, colour in marks:
        assert opacity == 1.0
        assert contrast(colour.lstrip("#"), paper) > 3.0, colour


def test_the_days_of_a_lot_need_no_scrolling_on_a_phone(shown):
    page = shown(viewport={"width": 360, "height": 800})
    page.locator("summary", has_text="Days of this lot").first.click()
    table = page.locator(".days").first
    assert table.evaluate("(table) => table.scrollWidth <= table.clientWidth")
    assert table.locator("td[data-head^='Percentiles']").first.inner_text().count("; ") == 4


def test_on_a_phone_each_cell_of_sentences_names_its_column_and_is_wide(shown):
    page = shown(viewport={"width": 360, "height": 800})
    page.locator("details summary").first.click()
    cells = page.locator(".stacked td:visible")
    assert cells.count() == 2 * 4 + 4 + 2 * 3 * 5 + 2 + 4
    require_named_cells(cells)
    assert min(cell.bounding_box()["width"] for cell in cells.all()) > 300
