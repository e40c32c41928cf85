"""The page of `drupe watch` says what E of the last fruit leaves out."""

import pytest
from browser import assert_readable, chromium
from report_batches import batch_of

from reports.entries import HOLD, INSPECT, SHIP, FruitEntry, ScreenEntry, Suspect
from reports.kiosk_page import KioskEntry, judge_html, kiosk_html, login_html

SKIN = Suspect(name="skin", short="a stiff skin carries part of the load", advice="")
SLIP = Suspect(name="slip", short="the fruit slips", advice="")
UNKNOWN = Suspect(name="unknown", short="something that no known effect explains", advice="")
WITHOUT = "Neither E nor the advice accounts for it."


def page(**how):
    """The page after one fruit."""
    fruit = FruitEntry(fruit_id="N01", ok=True, outcome="graded", E_MPa=0.5, E_sd_MPa=0.05, **how)
    return kiosk_html(KioskEntry(name="m", batch=batch_of(fruit), recent=("N01",)))


@pytest.mark.parametrize("decision", [SHIP, HOLD, ""])
def test_what_the_screen_suspects_stands_beside_the_decision(decision):
    html = page(decision=decision, screen=ScreenEntry(p_value=0.01, suspects=(SKIN, SLIP)))
    assert "Missing physics suspected: a stiff skin carries part of the load, or slip." in html
    assert WITHOUT in html


def test_what_explain_found_stands_there_in_place_of_suspicions():
    html = page(decision=SHIP, mismatch="soft_spot", screen=ScreenEntry(suspects=(SKIN,)))
    assert "Missing physics: soft spot." in html
    assert "suspected" not in html


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"screen": ScreenEntry(p_value=0.4)},
        {"screen": ScreenEntry(suspects=(SKIN,)), "mismatch": "none"},
        {"mismatch": "skin", "mismatch_taken": True},
        {"screen": ScreenEntry(suspects=(SKIN,)), "reference": True},
        {"screen": ScreenEntry(suspects=(UNKNOWN,)), "decision": INSPECT},
    ],
)
def test_nothing_is_said_of_what_e_or_the_decision_take_into_account(how):
    assert WITHOUT not in page(**how)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_on_the_line_s_pages_and_nothing_is_cut_off(tmp_path, scheme):
    fruit = FruitEntry(
        fruit_id="N01", ok=True, outcome="graded", rank=1, E_MPa=0.4, E_sd_MPa=0.02, decision=SHIP
    )
    waiting = (("N02", "photos or fruit.ply"),)
    entry = KioskEntry(name="m", batch=batch_of(fruit), recent=("N01",), waiting=waiting)
    pages = {
        "kiosk": kiosk_html(entry, logout=True),
        "refused": kiosk_html(entry, fault="The page shows no fruit N09."),
        "judge": judge_html(fruit, ["soft", "firm"]),
        "login": login_html(401),
    }
    with chromium() as browser:
        for name, html in pages.items():
            path = tmp_path / f"{name}.html"
            path.write_text(html, encoding="utf-8")
            for width in (360, 800, 1280):
                page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
                page.goto(path.as_uri())
                assert_readable(page, width)
                page.close()
