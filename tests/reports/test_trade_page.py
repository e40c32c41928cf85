"""The page of `drupe firmness` in a browser: short with many fruit, heads that stay, accessible."""

from datetime import UTC, datetime

import pytest
from browser import chromium

from fem.firmness.trade_tests import trade_tests
from reports.trade_page import SizeEffect, TradeFruit, trade_html

pytestmark = pytest.mark.slow
TESTS = trade_tests()


def trade_page(count):
    """So many fruit, and one that was not simulated."""
    readings = {test.name: (12.34, 0.56) for test in TESTS}
    known = {"E_MPa": 0.4, "E_sd_MPa": 0.02, "diameter_mm": 58.0, "pit_share": 0.43, "readings": readings}
    fruit = [TradeFruit(fruit_id=f"N{k:03d}", **known) for k in range(count)]
    values = {test.name: [[1.0, 2.0], [2.0, 4.0]] for test in TESTS}
    sizes = SizeEffect(
        E_MPa=0.4, poisson_ratio=0.45, diameters_mm=(40.0, 60.0), pit_shares=(0.0, 0.45), values=values
    )
    return trade_html(
        TESTS, [*fruit, TradeFruit(fruit_id="lost", reason="no contact")], sizes,
        made_utc=datetime(2026, 11, 20, 9, tzinfo=UTC), graded_utc="2026-11-20T08:00:00Z", folder="monday",
    )  # fmt: skip


@pytest.fixture
def shown(tmp_path):
    """Opens the page with so many fruit."""
    with chromium() as browser:

        def show(count, **context):
            (tmp_path / "firmness.html").write_text(trade_page(count), encoding="utf-8")
            page = browser.new_page(**context)
            page.goto((tmp_path / "firmness.html").as_uri())
            return page

        yield show


@pytest.mark.parametrize("width", [390, 768, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_and_nothing_is_cut_off(shown, scheme, width):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page = shown(40, viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.locator("summary").click()
    violations = axe.Axe().run(page).response["violations"]
    assert [(v["id"], v["nodes"][0]["html"][:120]) for v in violations] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_on_a_phone_many_fruit_are_one_screen_and_heads_and_names_stay(shown):
    phone = {"viewport": {"width": 390, "height": 844}}
    height = "document.documentElement.scrollHeight"
    few, page = shown(1, **phone), shown(500, **phone)
    assert page.evaluate(height) < few.evaluate(height) + 844
    page.locator(".box").first.evaluate("(box) => box.scrollTo(box.scrollWidth, 9000)")
    box = page.locator(".box").first.bounding_box()
    corner = page.locator(".box thead th").first.bounding_box()
    assert (corner["x"], corner["y"]) == pytest.approx((box["x"], box["y"]), abs=1)
    lost = page.locator(".box").first.locator("tbody th").last.bounding_box()
    assert lost["x"] == pytest.approx(box["x"], abs=1)
    assert lost["width"] < 0.4 * box["width"]
