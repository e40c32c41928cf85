"""Pages in headless Chromium, where Chromium and playwright are installed."""

import os
import shutil
from contextlib import contextmanager

import pytest

CHROMIUM = os.environ.get("DRUPE_CHROMIUM") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
NODES = """() => {
  const walker = document.createTreeWalker(document, NodeFilter.SHOW_ALL);
  let count = 1;
  while (walker.nextNode()) count += 1;
  return count;
}"""
"""Counts all nodes of the document: elements, text and comments."""
PROCESSOR_S = "ProcessTime"
"""Chromium's name for the processor time of the page's process, s."""
UNNAMED = """() => [...document.querySelectorAll('.stacked table')].flatMap((table) => {
  const heads = [...table.querySelectorAll('thead th')].map((head) => head.textContent.trim());
  const stacked = getComputedStyle(table).display === 'block';
  return [...table.querySelectorAll('tbody tr')].flatMap((row) => [...row.children].filter((cell, k) => {
    if (cell.tagName === 'TH' || cell.colSpan > 1) return false;
    const shown = getComputedStyle(cell, '::before').content;
    return cell.dataset.head !== heads[k] || (stacked && shown !== JSON.stringify(heads[k] + ': '));
  }).map((cell) => cell.outerHTML));
})"""
"""Cells of stacked tables that do not show their column's head where the table is one column wide."""
LOADED_MS = "() => performance.getEntriesByType('navigation')[0].loadEventEnd"


@contextmanager
def chromium():
    """A headless browser, which the test skips without."""
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


def assert_readable(page, width):
    """All folds open: axe-core finds nothing, the page is no wider than the window of so many px, and every
    cell of a stacked table names its column.
    """
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    for summary in page.locator("summary").all():
        summary.click()
    violations = axe.Axe().run(page).response["violations"]
    assert [(v["id"], v["nodes"][0]["html"][:120]) for v in violations] == [], page.url
    assert page.evaluate("document.documentElement.scrollWidth") <= width, page.url
    assert page.evaluate(UNNAMED) == [], page.url


def reloaded(page):
    """Loads the page again: seconds until it is loaded, and seconds of its process's processor time."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")

    def processor_s():
        metrics = session.send("Performance.getMetrics")["metrics"]
        return next(metric["value"] for metric in metrics if metric["name"] == PROCESSOR_S)

    before_s = processor_s()
    page.reload()
    return page.evaluate(LOADED_MS) / 1000, processor_s() - before_s


def require_named_cells(cells):
    """Each cell of a table for phones shows the head of its own column before its value."""
    for cell in cells.all():
        shown, head = cell.evaluate(
            "(cell) => [getComputedStyle(cell, '::before').content,"
            " cell.closest('table').tHead.rows[0].cells[cell.cellIndex].textContent]"
        )
        assert shown.strip('"').replace("\u00a0", " ") == head.replace("\u00a0", " ") + ": "


def busy():
    """Whether more programs want to run than there are processors, so that times say little."""
    return os.getloadavg()[0] > (os.cpu_count() or 1)
