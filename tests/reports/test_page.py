"""The report's page: its first screen, its tables, and its words."""

import base64
import csv
import hashlib
import html
import io
import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import reports
from reports.batch_overview import MOST_LINKED, MOST_LISTED, class_counts, decision_lists, failures, numbered
from reports.entries import BatchEntry, FruitEntry, FruitPictures, Picture, ScreenEntry, Suspect
from reports.grasp_record import CurveRecord, GraspRecord
from reports.page import report_html
from reports.tables import ranking_csv, safe_cell
from reports.words import number, percent, remarks, verdict, with_sd

VOID = {"meta", "img", "br", "link", "input"}
STATIC = Path(reports.__file__).parent / "static"
LIBRARY = (STATIC / "uplot.js").read_text()


class Page(HTMLParser):
    """Elements with their attributes, all text, and whether every element was closed in order."""

    def __init__(self, text):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len({name for name, _ in attrs}) == len(attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


def opened(text):
    """The page with every fruit opened, as its script shows one at a time, and without its scripts."""
    match = re.search(r'<script type="application/json" id="details">(.*?)</script>', text, re.DOTALL)
    cards = [json.loads(line) for line in match[1].splitlines()] if match else []
    parts = "".join(
        card["html"].replace('="fruit-name"', f'="fruit-{k}-name"') for k, card in enumerate(cards)
    )
    bare = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    return bare.replace('<div id="card"></div>', parts)


def ranked(fruit_id, rank=1, **facts):
    """A graded fruit of 0.3 MPa."""
    return FruitEntry(fruit_id=fruit_id, ok=True, outcome="graded", rank=rank, E_MPa=0.3, **facts)


def text_of(batch):
    """What the page shows, without its breakless spaces."""
    return "".join(Page(opened(report_html(batch))).text).replace("\u00a0", " ")


@pytest.fixture(params=["awkward_batch", "large_batch", "empty_batch"])
def batch(request):
    made: BatchEntry = request.getfixturevalue(request.param)
    return made


def test_page_refers_to_nothing_outside_itself(batch):
    text = report_html(batch)
    page = Page(opened(text))
    for tag, attributes in page.elements:
        assert tag not in {"link", "iframe", "object", "embed", "base", "use", "image"}
        assert not any(name.startswith("on") for name in attributes)
        assert not {"srcset", "xlink:href", "action", "background", "poster"} & set(attributes)
        if "src" in attributes:
            assert re.match(r"data:image/(webp|png);base64,", attributes["src"] or "")
        if "href" in attributes:
            assert re.match(r"#|fruits/[^/:]+/[a-z-]+\.(png|jpg|webp)$", attributes["href"] or "")
    assert "url(" not in text
    assert "@import" not in text
    bare = text.replace(LIBRARY, "")  # a comment of the library has its address
    assert "http:" not in bare
    assert "https:" not in bare


def test_every_link_has_its_target_and_every_id_is_one_element(batch):
    page = Page(opened(report_html(batch)))
    ids = Counter(attributes["id"] for _, attributes in page.elements if "id" in attributes)
    assert set(ids.values()) == {1}
    for _, attributes in page.elements:
        if (attributes.get("href") or "").startswith("#") and "=" not in (attributes["href"] or ""):
            assert (attributes["href"] or "").removeprefix("#") in ids
        if "aria-labelledby" in attributes:
            assert attributes["aria-labelledby"] in ids


def test_text_of_the_batch_is_shown_never_obeyed(awkward_batch, hostile):
    shown = "".join(Page(opened(report_html(awkward_batch))).text)
    assert shown.count(hostile) >= 5


def test_the_only_scripts_are_the_page_s_own_by_their_hashes(awkward_batch):
    text = report_html(awkward_batch)
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert text.count("<script") - text.count('<script type="application/json"') == len(scripts)
    assert scripts == [(STATIC / name).read_text() for name in ("uplot.js", "charts.js", "dashboard.js")]
    (policy,) = (m["content"] for m in Page(text).all("meta") if m.get("http-equiv"))
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    sources = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert f"script-src {sources};" in (policy or "")
    assert "script-src 'unsafe" not in (policy or "")
    assert (policy or "").startswith("default-src 'none';")


def test_the_library_of_the_charts_is_the_published_one():
    """docs/licences.md has the SHA-256 of uPlot's file in the npm registry; the licence is beside it."""
    digest = hashlib.sha256(LIBRARY.encode()).hexdigest()
    assert digest == "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f"
    assert digest in (STATIC.parents[1] / "docs" / "licences.md").read_text()
    assert "MIT License" in (STATIC / "uplot-licence.txt").read_text()


def test_no_text_of_a_batch_ends_the_script_that_holds_it(empty_batch):
    name = "</script><!--<script>alert(1)"
    text = report_html(replace(empty_batch, fruits=(ranked(name),)))
    held = re.search(r'id="lot">(.*?)</script>', text, re.DOTALL)[1]
    assert json.loads(held)["fruits"][0]["id"] == name
    assert "<!--<script" not in text


def test_the_embedded_rows_are_those_of_the_ranking_and_in_its_order(awkward_batch):
    text = report_html(awkward_batch)
    lot = json.loads(re.search(r'id="lot">(.*?)</script>', text, re.DOTALL)[1])
    lines = [lot["header"], *(fruit["csv"] for fruit in lot["fruits"])]
    assert "\n".join(lines) + "\n" == ranking_csv(awkward_batch)
    table = text[text.index("<noscript>") : text.index("</noscript>")]
    ids = re.findall(r'<th scope="row"><a[^>]*>(.*?)</a>', table)
    assert [html.unescape(each) for each in ids] == [fruit["id"] for fruit in lot["fruits"]]


def test_failures_come_first_with_reason_and_what_to_do(awkward_batch):
    shown = text_of(awkward_batch)
    order = ["4 of 6 fruit graded", "Not graded: 2 of 6", "were given, with, commas"]
    places = [shown.index(words) for words in [*order, "Ranking, softest first", "Fruit by fruit"]]
    assert places == sorted(places)


def test_fruits_follow_by_rank_then_failures(awkward_batch, hostile):
    text = "".join(Page(opened(report_html(awkward_batch))).text)
    parts = text[text.index("Fruit by fruit") : text.index("Sources of these numbers")]
    places = [parts.rindex(words) for words in ("N-04", "N-01", "orchard-7-", hostile, "=1+1", "N-07")]
    assert places == sorted(places)


def test_page_can_be_read_without_eyes(awkward_batch):
    page = Page(opened(report_html(awkward_batch)))
    assert page.all("html") == [{"lang": "en"}]
    assert len(page.all("h1")) == 1
    assert all(image["alt"] for image in page.all("img"))
    assert all(svg.get("aria-hidden") == "true" for svg in page.all("svg"))
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert all(cell.get("scope") for cell in page.all("th"))


def test_same_records_give_the_same_page(awkward_batch):
    assert report_html(awkward_batch) == report_html(awkward_batch)


def test_a_mismatch_that_nothing_explains_or_several_do_is_told_as_that(empty_batch):
    fruits = tuple(
        ranked(mismatch, rank, mismatch=mismatch)
        for rank, mismatch in enumerate(("unknown", "skin|graded_modulus"), start=1)
    )
    shown = text_of(replace(empty_batch, fruits=fruits))
    assert "mismatch: unknown, do not trust E" in shown
    assert "no known effect explains it. Do not trust E." in shown
    assert "mismatch: skin or graded modulus" in shown
    assert "cannot distinguish skin or graded modulus. Use E with caution." in shown


@pytest.mark.parametrize(
    ("count", "words"), [(0, "holds no fruit"), (1, "The only fruit is not"), (2, "None of the 2")]
)
def test_verdict_of_a_batch_without_a_graded_fruit(count, words, empty_batch):
    lost = tuple(FruitEntry(fruit_id=str(k), ok=False, outcome="crashed") for k in range(count))
    assert words in report_html(replace(empty_batch, fruits=lost))


def test_a_fruit_of_photos_shows_what_they_saw_of_it_and_one_of_a_mesh_does_not(graded, empty_batch):
    fruit = graded("N-1", rank=1, E_MPa=0.3)
    for words, picture in (
        ("coloured by the standard deviation of the surface in mm", "surface_sd"),
        ('href="fruits/N%201/outlines.jpg">All photos with their outlines', "outlines"),
        ("the outline from which drupe computed the shape", "outlines"),
    ):
        assert words in opened(report_html(replace(empty_batch, fruits=(fruit,))))
        without = replace(fruit, pictures=replace(fruit.pictures, **{picture: None}))
        assert words not in opened(report_html(replace(empty_batch, fruits=(without,))))


def test_a_body_without_a_pit_is_drawn_without_one(empty_batch):
    fruit = ranked("ball", pictures=FruitPictures(mesh=Picture(content=b"webp")))
    for has_pit in (False, True):
        page = report_html(replace(empty_batch, fruits=(replace(fruit, has_pit=has_pit),)))
        assert ("the assumed pit inside" in page) == has_pit
        assert ("with the pit inside" in page) == has_pit


UNEXPLAINED = Suspect(name="unknown", short="something else", advice="Look at it.")
SKIN = Suspect(name="skin", short="a stiff skin", advice="")


def test_the_colours_of_the_mesh_are_explained_in_the_language_of_the_page(empty_batch):
    grasp = GraspRecord(
        grasp="grasp-1",
        contact_mm={"left": [(30.0, 0.0, 0.0)], "right": [(-30.0, 0.0, 0.0)]},
        curves=[CurveRecord(pad=pad, travel_mm=[0.0, 1.0], force_N=[0.0, 5.0]) for pad in ("left", "right")],
    )
    pictures = FruitPictures(mesh=Picture(content=b"RIFF", file="mesh.webp"))
    fruit = ranked("A", has_pit=True, pictures=pictures, recordings=(grasp,))
    said = report_html(replace(empty_batch, fruits=(fruit,)), language="de")
    assert all(words in said for words in ("Kissen links", "Kissen rechts", "z: Stiel, x: Naht"))
    assert not any(words in said for words in ("Kissen left", "pad left", "stem and suture"))


def test_what_the_screen_says_of_a_fruit_stands_in_table_and_details(empty_batch):
    screens = (
        ScreenEntry(p_value=0.4),
        ScreenEntry(p_value=0.0123, suspects=(UNEXPLAINED, SKIN)),
        ScreenEntry(why_not="one recording alone tells too little"),
    )
    fruits = tuple(ranked(f"f{k}", k, screen=screen) for k, screen in enumerate(screens, start=1))
    shown = text_of(replace(empty_batch, fruits=fruits, screened=True))
    assert "none found (p = 0.40)" in shown
    assert "unknown? (p = 0.012)" in shown
    assert "Missing physics suspected (p = 0.012): something else. The test cannot" in shown
    assert "Look at it. Run drupe explain --fruit f2 for" in shown
    assert "Not screened for missing physics: one recording alone tells too little." in shown
    assert 'scope="col">Missing physics' not in report_html(replace(empty_batch, fruits=fruits[:1]))


def test_the_screen_of_a_fruit_with_a_confirmed_effect_speaks_of_what_is_left(empty_batch):
    known = {"mismatch": "viscoelastic", "mismatch_taken": True}
    fruit = ranked("a", **known, screen=ScreenEntry(p_value=0.4))
    shown = text_of(replace(empty_batch, fruits=(fruit,), screened=True))
    assert "Taken into account: viscoelastic" in shown
    assert "Missing physics: none found beyond that (p = 0.40)." in shown


@pytest.mark.parametrize(
    ("lot", "coded"),
    [("桃" * 20, True), ("x" * 300, False), ("桃" * 260, False), ("b\udce4\ud800", True)],
    ids=["some", "many", "too many for any code", "no text"],
)
def test_a_name_too_long_for_a_code_costs_the_code_alone(awkward_batch, lot, coded):
    page = report_html(replace(awkward_batch, lot=lot))
    assert page.count("Code of ") == coded * (1 + len(awkward_batch.fruits))
    assert 'src="data:image/png;base64,"' not in page


def lost(fruit_id, reason, outcome="never-touches"):
    return FruitEntry(
        fruit_id=fruit_id,
        ok=False,
        outcome=outcome,
        reason=reason,
        decision="inspect",
        decision_reason="not graded",
    )


def test_failures_of_one_cause_are_one_and_their_numbers_do_not_part_them(empty_batch):
    fruits = (
        lost("A", "grasp-1 of A misses it by 3.2 mm."),
        lost("B", "grasp-1 of B misses it by 14 mm."),
        lost("C", "Two photos.", "too-few-views"),
        lost("D", "One is black.", "too-few-views"),
        lost("E", "None.", "too-few-views"),
    )
    groups = failures(numbered(replace(empty_batch, fruits=fruits)))
    assert [(failure.outcome, len(failure.fruits)) for failure in groups] == [
        ("too-few-views", 3),
        ("never-touches", 2),
    ]
    assert groups[0].same_reason == ""
    assert groups[1].same_reason == "grasp-1 of A misses it by 3.2 mm."
    page = report_html(replace(empty_batch, fruits=fruits))
    assert "2 fruit <code>never-touches</code>" in page
    assert page.count("Check that the gripper closed on the fruit") == 1 + 2  # once, and in each fruit's part
    assert "One is black." in page


def test_lists_name_their_fruit_and_why(empty_batch, graded):
    fruits = (
        replace(graded("S", rank=1, E_MPa=0.2), decision="ship"),
        replace(graded("H", rank=3, E_MPa=0.9, maturity="unripe"), decision="hold"),
        replace(
            graded("B", rank=2, E_MPa=0.34),
            decision="inspect",
            decision_reason="borderline: ship with probability 63 %",
            other_class="unripe",
            other_class_probability=0.37,
        ),
        lost("L", "No."),
    )
    batch = replace(empty_batch, fruits=fruits, classes=(("ripe", 0.35), ("unripe", None)), ships=("ripe",))
    lists = decision_lists(batch, numbered(batch))
    assert [[fruit.fruit_id for _, fruit in list_.fruits] for list_ in lists] == [["S"], ["H"], ["B", "L"]]
    assert [reason for reason, _ in lists[2].groups] == ["borderline", "not graded"]
    assert class_counts(batch, numbered(batch)) == (("ripe", 2, 1), ("unripe", 1, 0))
    page = report_html(batch)
    assert "or unripe (37" in page
    assert '<option value="hold">Hold</option>' in page


def test_long_lists_have_few_links_and_the_table_has_the_rest(large_batch, graded):
    count = MOST_LISTED + 10
    fruits = tuple(
        replace(graded(f"N-{k:03d}", rank=k + 1, E_MPa=0.2 + 0.002 * k), decision="ship")
        for k in range(count)
    )
    page = report_html(replace(large_batch, fruits=fruits, ships=("ripe",)))
    card = page[page.index('class="card ship"') : page.index('class="card hold"')]
    assert card.count('href="#fruit-') == MOST_LINKED
    assert f'<a href="#list=ship">all {count} in the table</a>' in card
    assert "See the table of all fruits." in card
    few = report_html(replace(large_batch, fruits=fruits[:20], ships=("ripe",)))
    assert ", ".join(fruit.fruit_id for fruit in fruits[:20]) in few


SUSPECTS = tuple(Suspect(name=name, short="", advice="") for name in ("skin", "poisson_ratio"))
FIXED_COLUMNS = (
    "rank,fruit_id,outcome,E_MPa,E_sd_MPa,maturity,maturity_probability,p_softer_than_next,"
    "height_mm,volume_mm3,grasps,shore_oo,mismatch,reason"
)


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_columns_are_the_fixed_ones_in_order_and_more_may_follow(awkward_batch, empty_batch):
    for batch in (awkward_batch, empty_batch):
        assert ranking_csv(batch).splitlines()[0].startswith(FIXED_COLUMNS)


def test_softest_is_first_and_failures_are_last(awkward_batch):
    rows = rows_of(ranking_csv(awkward_batch))
    assert [row["rank"] for row in rows] == ["1", "2", "3", "4", "", ""]
    assert [row["outcome"] for row in rows][-2:] == ["too-few-views", "never-touches"][::-1]


def test_unknown_values_are_empty_cells(awkward_batch):
    bare = rows_of(ranking_csv(awkward_batch))[2]
    assert [bare[name] for name in ("E_sd_MPa", "maturity", "height_mm", "shore_oo", "mismatch")] == [""] * 5


def test_values_survive_to_the_figures_claimed(awkward_batch, graded):
    fruit = replace(graded("a", rank=1, E_MPa=0.123456), E_sd_MPa=0.00123456)
    row = rows_of(ranking_csv(replace(awkward_batch, fruits=(fruit,))))[0]
    assert (row["E_MPa"], row["E_sd_MPa"]) == ("0.1235", "0.00123")
    assert (row["height_mm"], row["volume_mm3"], row["grasps"]) == ("57.12", "104124", "1")


def test_each_fruit_is_one_line_whatever_its_text(awkward_batch):
    text = ranking_csv(awkward_batch)
    assert len(text.splitlines()) == 7
    assert rows_of(text)[-1]["reason"] == "Only 2 photos were given, with, commas."


HOSTILE = (
    *("=1+1", "-1+cmd", "@SUM(A1)", "\t=1", "\r=1", "\n=1"),
    "lot 7;=cmd|' /C calc'!A0",
    "a,=1+1",
    'a; "=HYPERLINK(1)"',
    "a\t@SUM(A1)",
    ";+A1",
    "a,+1+cmd|' /C calc'!A0",
    "a;-1,5*(A1)",
    "a\t- 1 % + cmd",
    "a;--1",
    "a;-1:1+cmd",
    "a,-.5e3^A1",
    'a,-"x"&A1',
    "x;\u00a0-1+cmd",
    '"=1+1"',
    "\uff1d1+1",
)


def cells_by(text, separator):
    """All cells as a spreadsheet with this separator splits them, without blanks and quotes at the front."""
    table = csv.reader(io.StringIO(text), delimiter=separator)
    return {cell.lstrip('\t "\u00a0') for row in table for cell in row}


@pytest.mark.parametrize("text", HOSTILE)
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_no_separator_makes_a_formula_of_a_part_of_a_cell(text, separator, awkward_batch):
    fruit = FruitEntry(
        fruit_id=text, ok=False, outcome="x", reason=text, mismatch=text, warnings=(text, text)
    )
    batch = replace(awkward_batch, fruits=(fruit,))
    for cell in cells_by(ranking_csv(batch), separator):
        assert not cell.startswith(("=", "+", "-", "@", "\uff1d")), cell
    assert safe_cell(safe_cell(text)) == safe_cell(text)


@pytest.mark.parametrize(
    "text",
    [
        "a - b", "E is 0.4 ± 0.1, 3 - 2", "N-7; N-8", "p = 0.01", "x+y@z", "offset (0.1, -0.3) mm",
        "lot A,-7", "lot A, -7, -8 and +9", "a;-0,5;+1", "1,-2.5e-3 mm",
        "shift, -3 %", "a,-7;b", "a, -", "a\t-7",
    ],
)  # fmt: skip
def test_text_that_is_no_formula_stays_as_it_is(text):
    assert safe_cell(text) == text


def test_a_reference_body_stands_last_without_rank_or_class(empty_batch):
    """After the fruit that failed, and marked in a column of its own."""
    ball = FruitEntry(
        fruit_id="a ball", ok=True, outcome="graded", E_MPa=0.01, E_sd_MPa=0.001, reference=True
    )
    fruit = FruitEntry(fruit_id="b", ok=True, outcome="graded", E_MPa=0.5, E_sd_MPa=0.01, rank=1)
    lost = FruitEntry(fruit_id="c", ok=False, outcome="no-shape")
    rows = rows_of(ranking_csv(replace(empty_batch, fruits=(ball, lost, fruit))))
    assert [row["fruit_id"] for row in rows] == ["b", "c", "a ball"]
    assert [row["reference"] for row in rows] == ["", "", "true"]
    assert (rows[2]["outcome"], rows[2]["rank"], rows[2]["maturity"]) == ("graded", "", "")


@pytest.mark.parametrize(
    ("known", "cells"),
    [
        ({}, ("", "", "", "")),
        ({"screen": ScreenEntry(p_value=0.43)}, ("none", "screen", "none", "0.43")),
        (
            {"screen": ScreenEntry(p_value=0.012, suspects=SUSPECTS)},
            ("skin|poisson_ratio", "screen", "skin|poisson_ratio", "0.012"),
        ),
        (
            {"screen": ScreenEntry(why_not="too few")},
            ("not screened: too few", "screen", "not screened: too few", ""),
        ),
        (
            {"screen": ScreenEntry(p_value=0.43), "mismatch": "slip"},
            ("slip", "explain", "none", "0.43"),
        ),
        (
            {"screen": ScreenEntry(p_value=0.43), "mismatch": "slip", "mismatch_taken": True},
            ("slip", "settings", "none", "0.43"),
        ),
    ],
)
def test_the_mismatch_is_that_of_settings_else_explain_else_screen(known, cells, awkward_batch, graded):
    fruit = replace(graded("a", rank=1, E_MPa=0.3), **known)
    row = rows_of(ranking_csv(replace(awkward_batch, fruits=(fruit,))))[0]
    assert tuple(row[name] for name in ("mismatch", "mismatch_by", "screen", "screen_p")) == cells


@given(st.floats(1e-6, 1e7))
def test_a_figure_is_told_to_three_digits(value):
    assert float(number(value)) == pytest.approx(value, rel=0.0051)


@given(st.floats(0.01, 10.0), st.floats(1e-4, 1.0))
def test_value_and_deviation_share_their_decimals_and_keep_the_deviation(value, share):
    printed, deviation = with_sd(value, share * value).split(" ± ")
    assert len(printed.partition(".")[2]) == len(deviation.partition(".")[2])
    assert float(printed) == pytest.approx(value, abs=0.5 * share * value + 1e-4 * value)


@given(st.floats(0.0, 1.0))
def test_no_probability_is_told_as_certain(probability):
    assert percent(probability).replace("\u00a0", " ") not in {"0 %", "100 %"}


def test_fruit_that_wait_in_an_unfinished_run_are_counted():
    done = FruitEntry(fruit_id="a", ok=True, outcome="graded", E_MPa=0.4)
    assert verdict((done,), waiting=3).startswith("1 of 4 fruit graded: a has E")
    lost = FruitEntry(fruit_id="b", ok=False, outcome="no-fruit")
    assert verdict((lost,), waiting=3) == "0 of 4 fruit graded."


def test_a_doubt_about_E_stands_before_the_warnings():
    doubted = FruitEntry(
        fruit_id="a", ok=True, outcome="graded", E_MPa=0.4, doubts=("grasp-1: a gain.",), warnings=("dim",)
    )
    assert remarks(doubted) == "E is in doubt, 1 warning"
    assert remarks(replace(doubted, class_withheld=True)) == "E is in doubt, so no class, 1 warning"
    assert verdict((doubted,)) == "The only fruit is graded: a has E = 0.400 MPa, in doubt.".replace(
        "0.400 MPa", "0.400\u00a0MPa"
    )
