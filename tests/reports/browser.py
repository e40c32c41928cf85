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
