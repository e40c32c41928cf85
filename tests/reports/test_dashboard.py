"""The report in a browser: size, time, filters, charts, export, printing, keyboard and accessibility."""

import csv
import io
import re
from dataclasses import replace
from datetime import UTC, date, datetime
from urllib.parse import parse_qs

import cv2
import numpy as np
import pytest
from browser import NODES, assert_readable, busy, chromium, reloaded
from report_batches import batch_of

from reports.entries import FruitEntry, Picture, ScreenEntry, VerdictEntry
from reports.language import ENGLISH, LANGUAGES
from reports.page import report_html
from reports.sheet_code import sheet_code
from reports.tables import ranking_csv

pytestmark = pytest.mark.slow
MOST_NODES, MOST_LOAD_S = 2000, 1.5
"""Of a report of 500 fruit: nodes at a time; seconds until loaded, by the clock and of the processor."""
TIMEOUT_MS = 120_000
"""Of each step: on a busy machine a browser starts slowly."""
ENDS = """() => {
  const place = (of) => of.getBoundingClientRect();
  const sheet = document.querySelector("#card article");
  const parts = [...sheet.children].filter((part) => part.offsetHeight && !part.matches(".qr"));
  return parts.flatMap((part, k) => {
    const end = k + 1 < parts.length ? place(parts[k + 1]).top : place(sheet).bottom;
    const inside = [part, ...part.querySelectorAll("tr, figure, figcaption, img, canvas")];
    return inside.map(place).filter((each) => each.height).map((each) => [each.top, each.bottom, end + 1]);
  });
}"""
"""Top and bottom of all that a sheet shows of a fruit, and where the next part begins or the sheet ends."""
FIRST_FOUR = """() => {
  const cells = document.querySelectorAll("table.fruit tr:not(.space) > :nth-child(-n + 4)");
  return [...cells].map((cell) => [
    cell.getBoundingClientRect().right,
    ...[cell, ...cell.querySelectorAll(".soft")].map((part) => part.scrollWidth - part.clientWidth),
  ]);
}"""
"""Where each cell of the first four columns ends, and how much of each of its lines is cut off, px."""
UNCOVERED = """() => {
  const { left, right, top, bottom } = document.activeElement.getBoundingClientRect();
  const on_top = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
  return document.activeElement.contains(on_top) || on_top.contains(document.activeElement);
}"""
"""Whether nothing covers the middle of the part with the focus."""
ACTIVE = """() => document.activeElement === document.body ? "BODY"
  : document.activeElement.matches(".skip") ? "SKIP"
  : document.activeElement.closest("table.fruit tbody tr") ? document.activeElement.innerText : "" """
"""The fruit of the table with the focus; BODY: no part of the page has it; SKIP: its first link has it."""
CLASSES = (("ripe", 0.5), ("firm", 0.9), ("unripe", None))
READING = {
    "en": "Plates, 2\u00a0% of the diameter (N)",
    "de": "Platten, 2\u00a0% des Durchmessers (N)",
    "es": "Platos, 2\u00a0% del diámetro (N)",
}
"""A column of simulated firmness tests in each language."""
WITHHELD = {"maturity": None, "class_withheld": True, "decision": "inspect"}


def lot(graded, template, count):
    """So many fruit, E from 0.2 by rank, and one that was not graded."""
    E_MPa = 0.2 + np.arange(count) / count
    fruits = [
        replace(
            graded(f"N-{k:03d}", rank=k + 1, E_MPa=float(E)),
            maturity=next(name for name, limit in CLASSES if limit is None or limit >= E),
            decision="ship" if E <= 0.5 else "hold",
            facts=tuple((f"Part: fact {j}", "1.0 mm") for j in range(40)),
        )
        for k, E in enumerate(E_MPa)
    ]
    lost = FruitEntry(
        fruit_id="lost", ok=False, outcome="no-photos", reason="No photo.", decision="inspect",
        decision_reason="not graded",
    )  # fmt: skip
    words = {
        name: tuple((f"{name}: {k}", "1.0") for k in range(count))
        for name, count in (("settings", 45), ("versions", 25))
    }
    return replace(
        template, fruits=(*fruits, lost), classes=CLASSES, ships=("ripe",), shore=None, inputs=(), **words
    )


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


VERDICT = VerdictEntry(
    judged_class="firm", by="A. Huber", why="hard at the suture", E_MPa=0.2, E_sd_MPa=0.01,
    at_utc=datetime(2026, 11, 28, 9, 30, tzinfo=UTC),
)  # fmt: skip


@pytest.fixture
def shown(browser, tmp_path, awkward_batch, graded):
    """Opens the report of a batch, or of a lot of so many fruit, at an address; fails on any message of the
    browser.
    """
    complaints = []
    contexts = []

    def show(count=0, *, batch=None, hash_="", language=ENGLISH, **context):
        batch = batch or lot(graded, awkward_batch, count)
        path = tmp_path / "report.html"
        path.write_text(report_html(batch, language=language), encoding="utf-8")
        contexts.append(browser.new_context(offline=True, accept_downloads=True, **context))
        page = contexts[-1].new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"{path.as_uri()}{hash_}", timeout=TIMEOUT_MS)
        return page, batch

    yield show
    for context in contexts:
        context.close()
    assert complaints == []


def rows_shown(page):
    return page.locator("form.tools output").inner_text().partition(":")[0]


def state(page):
    return {name: values[0] for name, values in parse_qs(page.url.partition("#")[2]).items()}


def test_five_hundred_fruit_load_fast_and_are_few_nodes_wherever_a_reader_scrolls(shown):
    page, _ = shown(500)
    loads = [reloaded(page) for _ in range(3)]
    assert 0.0 < min(processor_s for _, processor_s in loads) <= MOST_LOAD_S
    if not busy():
        assert min(loaded_s for loaded_s, _ in loads) <= MOST_LOAD_S
    page.locator("#card summary").click()
    counts = []
    for top in (0, 3000, 10**6):
        page.locator(".box").evaluate("(box, top) => { box.scrollTop = top; }", top)
        page.wait_for_timeout(100)
        counts.append(page.evaluate(NODES))
    assert max(counts) <= MOST_NODES
    assert page.locator("table.fruit tbody tr:not(.space) th").last.inner_text() == "lost"


def test_verdict_both_moduli_and_own_columns_are_in_table_and_fruit(shown, awkward_batch, graded):
    batch = lot(graded, awkward_batch, 3)
    first, *others = batch.fruits
    first = replace(
        first,
        verdicts=(VERDICT,),
        E_at_pulp_MPa=0.231,
        E_at_pulp_sd_MPa=0.012,
        columns={"Brix": 12.5625, "grower": "Mayr"},
        readings={"plates_2pct_N": 9.12, "plates_2pct_N_sd": 0.71},
    )
    batch = replace(
        batch,
        fruits=(first, *others),
        columns=(("Brix", "°Brix"), ("grower", "")),
        readings=("plates_2pct_N", "plates_2pct_N_sd"),
        reading_titles={"plates_2pct_N": ("Plates, 2 % of the diameter", "N")},
    )
    page, _ = shown(batch=batch)
    heads = page.locator("table.fruit thead th").all_inner_texts()
    rows = page.locator("table.fruit tbody tr:not(.space)")
    cells = [rows.nth(k).locator("th, td").all_inner_texts() for k in range(2)]
    expected = {
        "A person's verdict": ("A. Huber: firm", "–"),
        "E at the grasp's temperature (MPa)": ("0.231 ± 0.012", "–"),
        "Brix (°Brix)": ("12.5625", "–"),
        "grower": ("Mayr", "–"),
    }
    assert {name: tuple(row[heads.index(name)] for row in cells) for name in expected} == expected
    rows.first.locator("th a").click()
    said = page.locator("#card").inner_text().replace("\u00a0", " ")
    assert (
        "A person's verdict: A. Huber judged it firm on 2026-11-28 09:30 UTC (E = 0.200 ± 0.010 MPa)" in said
    )
    assert "At the temperature of the grasp E is 0.231 ± 0.012 MPa" in said
    page.locator("#card summary").click()
    facts = page.locator("#card dl.facts dt, #card dl.facts dd").all_text_contents()
    assert facts[-4:] == ["Brix", "12.5625 °Brix", "grower", "Mayr"]
    assert facts[-6:-4] == [READING["en"], "9.12 ± 0.71"]


@pytest.mark.parametrize(("language", "title"), READING.items())
def test_facts_show_a_readings_title_and_the_users_names_as_they_were_written(shown, graded, language, title):
    """As the reader sees them, after the style sheets."""
    written = {"brix": 12.5, "box nr": 7.0, "GROWER": "Mayr", "firmness": 3.0, "plates_9pct_N": 1.0}
    readings = {"plates_2pct_N": 9.12, "plates_2pct_N_sd": 0.71}
    bare = graded("N-1", rank=1, E_MPa=0.3)
    fruit = replace(bare, columns=written, readings=readings, facts=(("pit", "8"),))
    batch = replace(
        batch_of(fruit),
        columns=tuple((name, "") for name in written),
        readings=tuple(readings),
        reading_titles={"plates_2pct_N": ("Plates, 2 % of the diameter", "N")},
    )
    page, _ = shown(batch=batch, language=language)
    page.locator("#card summary").click()
    labels = page.locator("#card dl.facts dt").all_inner_texts()
    assert labels[-6:] == [title, *written]
    assert all(label[0].isupper() for label in labels[:-5])
    page.locator("[name=readings]").check()
    assert title in page.locator("table.fruit thead th.reading").all_inner_texts()


def test_without_scripts_there_is_a_table_of_all_fruit(shown):
    page, batch = shown(30, java_script_enabled=False)
    assert page.locator("table.fruit tbody tr").count() == len(batch.fruits)
    for part in ("form.tools", ".plots", "section.fruits"):
        assert not page.locator(part).is_visible()


def test_printing_gives_the_certificate_and_the_ranking_alone(shown):
    page, batch = shown(120)
    page.evaluate(
        "addEventListener('beforeprint', () => {"
        "  window.printed = document.querySelectorAll('.box th a').length; })"
    )
    sheets = len(re.findall(rb"/Type\s*/Page\b", page.pdf()))
    assert page.evaluate("window.printed") == len(batch.fruits)
    assert sheets <= 1 + 1 + len(batch.fruits) // 25
    page.emulate_media(media="print")
    seen = page.evaluate(
        "[...document.querySelectorAll('main > *')].filter((e) => e.offsetHeight).map((e) => e.className)"
    )
    assert set(seen) <= {"lot", "decisions", "ranking", "faults"}


@pytest.mark.parametrize(("part", "count"), [("one", 3), ("lot", 3), ("lot", 400)])
def test_a_sheet_is_one_page_with_a_code_that_another_reader_finds(shown, awkward_batch, graded, part, count):
    """The reader of the code is OpenCV's; not all warnings, grasps and verdicts of the fruit have a place."""
    batch = lot(graded, awkward_batch, count)
    said = tuple(
        f"Warning {k}: {'the photos do not show the underside of this fruit; ' * 6}" for k in range(20)
    )
    verdict = replace(VERDICT, why="hard at the suture " * 9)
    large = Picture(
        content=cv2.imencode(".webp", np.full((1200, 900, 3), 90, np.uint8))[1].tobytes(), file="a.jpg"
    )
    first = batch.fruits[0]
    first = replace(
        first, warnings=said, doubts=said[:2], grasps=20, recordings=20 * first.recordings,
        verdicts=5 * (verdict,), pictures=replace(first.pictures, photo=large, mesh=large),
    )  # fmt: skip
    batch = replace(
        batch, fruits=(first, *batch.fruits[1:]), lot="H/07", cultivar="Big Top", packer="Huber Obst",
        measured_on=date(2026, 8, 15), faults=said[:6],
    )  # fmt: skip
    sheet = {"viewport": {"width": 690, "height": 1017}, "device_scale_factor": 3, "color_scheme": "dark"}
    page, _ = shown(batch=batch, **sheet)
    page.evaluate("window.print = () => { window.sheet = document.body.className; }")
    page.locator(f"button.alone[data-part={part}]").first.click()
    assert page.evaluate("window.sheet") == part
    page.evaluate("(part) => document.body.classList.add(part)", part)
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))) == 1
    page.emulate_media(media="print")
    picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert cv2.QRCodeDetector().detectAndDecode(picture)[0] == sheet_code(
        "H/07", first.fruit_id if part == "one" else ""
    )
    sign = page.locator(".sign:visible").bounding_box()
    assert 0 < sign["y"] < sign["y"] + sign["height"] <= 1017
    text = page.locator("body").inner_text()
    if part == "one":
        for words in ("18 more warnings", "2 more notes", "14 more grasps"):
            assert f"and {words} in the report" in text
        ends = page.evaluate(ENDS)
        assert len(ends) >= 4 + 3 + 3 + 6 + 2 * 3
        assert all(0 <= top < bottom <= least for top, bottom, least in ends), ends
    else:
        assert "Warning 3" in text
        assert "and 2 more warnings in the report" in text
    for word in ("H/07", "Big Top", "Huber Obst", "2026-08-14", "2026-08-15", "Signature"):
        assert word in text
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_filters_are_in_the_address_and_come_back_from_it(shown):
    page, _ = shown(40)
    page.locator("[name=class]").select_option("firm")
    page.locator("[name=to]").fill("0.7")
    page.get_by_role("button", name="E (MPa)").click()
    page.get_by_role("button", name="E (MPa)").click()
    expected = sum(0.5 < 0.2 + k / 40 <= 0.7 + 1e-12 for k in range(40))
    assert rows_shown(page) == f"{expected} of 41 fruit"
    first = page.locator("table.fruit tbody th").first.inner_text()
    assert state(page) == {"class": "firm", "to": "0.7", "sort": "-4"}
    again, _ = shown(40, hash_="#" + page.url.partition("#")[2])
    assert rows_shown(again) == f"{expected} of 41 fruit"
    assert again.locator("table.fruit tbody th").first.inner_text() == first
    assert again.locator("[name=class]").input_value() == "firm"
    assert again.locator("thead [aria-sort=descending]").inner_text().startswith("E (MPa)")


def test_the_export_is_the_shown_rows_of_the_ranking(shown):
    page, batch = shown(40, hash_="#class=unripe&sort=-4")
    with page.expect_download() as coming:
        page.get_by_role("button", name="Save these rows as CSV").click()
    saved = list(csv.reader(io.StringIO(coming.value.path().read_text(encoding="utf-8-sig"))))
    header, *rows = csv.reader(io.StringIO(ranking_csv(batch)))
    unripe = [row for row in rows if row[header.index("maturity")] == "unripe"]
    assert saved == [header, *reversed(unripe)]
    assert coming.value.suggested_filename.endswith("-ranking.csv")


def test_the_histogram_counts_as_numpy_does_and_ends_bars_at_the_limits(shown):
    page, batch = shown(200)
    words = page.locator("#histogram .plot").get_attribute("aria-label")
    bars = [tuple(map(float, bar)) for bar in re.findall(r"([\d.]+)–([\d.]+) MPa: (\d+)", words)]
    edges = np.array([*(low for low, _, _ in bars), bars[-1][1]])
    assert {0.5, 0.9} <= set(edges)
    E = [fruit.E_MPa for fruit in batch.fruits if fruit.E_MPa is not None]
    counted, _ = np.histogram(E, edges)
    # a bar takes its upper end, NumPy's its lower; labels have four digits
    assert np.abs(counted - [count for _, _, count in bars]).max() <= 1
    assert sum(count for _, _, count in bars) == len(E)


@pytest.mark.parametrize(("language", "said"), [("en", "1 fruit"), ("de", "1 Frucht"), ("es", "1 fruto")])
def test_one_fruit_is_counted_in_the_singular(shown, awkward_batch, graded, language, said):
    batch = lot(graded, awkward_batch, 1)
    page, _ = shown(batch=replace(batch, fruits=batch.fruits[:1]), language=language)
    assert rows_shown(page) == said


def test_the_key_of_the_ranking_s_chart_names_each_class_once(shown):
    page, _ = shown(40)
    assert page.locator("#by-rank .key").all_inner_texts() == [name for name, _ in CLASSES]


@pytest.mark.parametrize(
    ("language", "name"), [("en", "no class"), ("de", "keine Klasse"), ("es", "sin clase")]
)
def test_the_key_names_marks_without_a_class_whatever_is_selected(
    shown, awkward_batch, graded, language, name
):
    batch = lot(graded, awkward_batch, 40)
    batch = replace(batch, fruits=(replace(batch.fruits[0], **WITHHELD), *batch.fruits[1:]))
    page, _ = shown(batch=batch, language=language, hash_="#class=unripe")
    assert page.locator("#by-rank .key").all_inner_texts() == [*(name for name, _ in CLASSES), name]
    assert page.locator("#by-rank .key").last.get_attribute("class") == "key marks circle"
    page, _ = shown(batch=replace(batch, classes=(), ships=None), language=language)
    assert page.locator("#by-rank .key").count() == 0


def test_a_drag_across_the_histogram_selects_fruit_and_a_double_click_shows_all(shown):
    page, batch = shown(40)
    plot = page.locator("#histogram .u-over")
    plot.scroll_into_view_if_needed()
    room = plot.bounding_box()
    across = [room["x"] + share * room["width"] for share in (0.3, 0.6)]
    page.mouse.move(across[0], room["y"] + 40)
    page.mouse.down()
    page.mouse.move(across[1], room["y"] + 40, steps=4)
    page.mouse.up()
    chosen = state(page)
    inside = [
        fruit for fruit in batch.fruits
        if fruit.E_MPa is not None and float(chosen["from"]) <= fruit.E_MPa <= float(chosen["to"])
    ]  # fmt: skip
    assert 5 < len(inside) < 25
    assert rows_shown(page) == f"{len(inside)} of 41 fruit"
    shipped = sum(fruit.decision == "ship" for fruit in inside)
    assert page.locator(".count[data-list=ship]").inner_text() in (f"{shipped} / 13", "13")
    plot.dblclick(position={"x": 30, "y": 30})
    assert rows_shown(page) == "41 fruit"


def test_all_of_it_works_by_keyboard(shown):
    page, _ = shown(40)
    page.locator("#by-rank .plot").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert "N-002" in page.locator("#by-rank .tip").inner_text()
    page.keyboard.press("Enter")
    assert state(page)["fruit"] == "N-002"
    assert page.evaluate("document.activeElement.id") == "fruit-name"
    assert "N-002" in page.locator("#fruit-name").inner_text()
    page.get_by_role("button", name="Next", exact=True).press("Enter")
    assert "N-003" in page.locator("#fruit-name").inner_text()
    page.go_back()
    assert "N-000" in page.locator("#fruit-name").inner_text()
    page.get_by_role("link", name="N-005").first.press("Enter")
    assert "N-005" in page.locator("#fruit-name").inner_text()


def tab_to(page, selector, *, key="Tab"):
    """Presses Tab until the focus is on such a part; the part is in sight."""
    for _ in range(60):
        page.keyboard.press(key)
        if page.evaluate("(selector) => document.activeElement.matches(selector)", selector):
            assert page.evaluate(UNCOVERED), selector
            return
    raise AssertionError(f"Tab does not reach {selector}")


def test_tab_enter_and_arrows_alone_filter_sort_open_and_export(shown):
    page, _ = shown(500)
    tab_to(page, ".skip")
    page.keyboard.press("Enter")
    tab_to(page, "[name=class]")
    page.keyboard.press("ArrowDown")
    tab_to(page, "[name=from]")
    page.keyboard.type("0.45")
    expected = sum(0.45 <= 0.2 + k / 500 <= 0.5 for k in range(500))
    assert rows_shown(page) == f"{expected} of 501 fruit"
    tab_to(page, "[aria-sort] button, th:nth-child(4) button")
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    assert page.locator("thead [aria-sort=descending]").inner_text().startswith("E (MPa)")
    tab_to(page, "tbody tr:not(.space):nth-child(3) a")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "fruit-name"
    assert page.locator("#fruit-name").inner_text().endswith("N-148")
    tab_to(page, "button.save", key="Shift+Tab")
    with page.expect_download() as coming:
        page.keyboard.press("Enter")
    saved = list(csv.DictReader(io.StringIO(coming.value.path().read_text(encoding="utf-8-sig"))))
    assert [row["fruit_id"] for row in saved] == [f"N-{k}" for k in range(150, 150 - expected, -1)]


def test_tab_goes_through_every_row_and_beyond_both_ways(shown):
    page, _ = shown(200)
    for key, first, end in (("Tab", "N-000", "BODY"), ("Shift+Tab", "lost", "SKIP")):
        rows, active = [], ""
        while active != end:
            page.keyboard.press(key)
            active = page.evaluate(ACTIVE)
            if active not in ("", "BODY", "SKIP"):
                rows.append(active)
                assert page.evaluate(UNCOVERED), active
            assert len(rows) < 300
        assert (rows[0], len(rows), len(set(rows))) == (first, 201, 201)


@pytest.mark.parametrize("width", [360, 800, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_and_nothing_is_cut_off(shown, width, scheme):
    page, _ = shown(40, viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert_readable(page, width)


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("width", [1000, 1280])
def test_the_table_of_a_lot_without_own_columns_is_whole(shown, graded, language, width):
    none_found = ScreenEntry(p_value=0.123)
    fruits = tuple(
        replace(
            graded(f"N-{k:03}", rank=k, E_MPa=0.3 + 0.02 * k, maturity="ready to buy"),
            screen=none_found,
            decision="hold",
        )
        for k in range(1, 13)
    )
    classes = (("ready to eat", 0.35), ("ready to buy", 0.6), ("firm", None))
    batch = replace(batch_of(*fruits), classes=classes, ships=("ready to eat",), screened=True)
    page, _ = shown(batch=batch, language=language, viewport={"width": width, "height": 900})
    box = page.locator(".box")
    assert page.locator("table.fruit thead th").count() == 12
    assert box.evaluate("(box) => box.scrollWidth - box.clientWidth") <= 0
    cut = "(row) => [...row.cells].filter((cell) => cell.scrollHeight > cell.clientHeight + 1).length"
    assert [row.evaluate(cut) for row in page.locator(".box tbody tr:not(.space)").all()] == [0] * 12


@pytest.mark.parametrize("language", LANGUAGES)
def test_on_a_phone_the_grasps_of_a_fruit_are_whole_and_name_their_columns(shown, language):
    page, _ = shown(3, language=language, viewport={"width": 360, "height": 800})
    table = page.locator("#card .table")
    assert table.evaluate("(table) => table.scrollWidth - table.clientWidth") <= 0
    heads = table.locator("thead th").all_text_contents()
    cells = table.locator("tbody td")
    named = cells.evaluate_all("(cells) => cells.map((cell) => getComputedStyle(cell, '::before').content)")
    assert named == [f'"{head}: "' for head in heads[1:]]


@pytest.mark.parametrize("language", LANGUAGES)
def test_on_a_phone_fruit_class_decision_and_E_come_first_and_are_whole(
    shown, awkward_batch, graded, language
):
    batch = lot(graded, awkward_batch, 40)
    first, second, third, *others = batch.fruits
    both = {"maturity_probability": 0.61, "other_class": "unripe", "other_class_probability": 0.38}
    changed = (replace(first, verdicts=(VERDICT,)), replace(second, **WITHHELD), replace(third, **both))
    batch = replace(batch, fruits=(*changed, *others))
    page, _ = shown(batch=batch, language=language, viewport={"width": 360, "height": 800})
    table, plots = (page.locator(part).bounding_box() for part in (".box", ".plots"))
    assert table["y"] < plots["y"]
    assert page.locator("table.fruit thead th").nth(3).inner_text() == "E (MPa)"
    cells = page.evaluate(FIRST_FOUR)
    assert len(cells) > 4 * 15
    assert max(right for right, *_ in cells) <= table["x"] + table["width"]
    assert max(max(hidden) for _, *hidden in cells) <= 0
