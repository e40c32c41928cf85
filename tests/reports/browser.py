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
