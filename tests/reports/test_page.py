import base64
import hashlib
import html
import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest

import reports
from reports.entries import BatchEntry, FruitEntry, FruitPictures, Picture, ScreenEntry, Suspect
from reports.grasp_record import CurveRecord, GraspRecord
from reports.page import report_html
from reports.tables import ranking_csv

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
    text = report_html(awkward_batch)
    shown = "".join(Page(opened(text)).text)
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
    licence = (STATIC / "uplot-licence.txt").read_text()
    assert "MIT License" in licence


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
    page = Page(opened(report_html(awkward_batch)))
    text = "".join(page.text)
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
    pictures = FruitPictures(mesh=Picture(content=b"webp"))
    fruit = ranked("ball", pictures=pictures)
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
    plain = report_html(replace(empty_batch, fruits=fruits[:1]))
    assert 'scope="col">Missing physics' not in plain


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
