"""A person's verdict is kept beside E, never in its place, and nobody changes one unnoticed."""

import hashlib
import json
import re
from unicodedata import normalize

import pytest
from graded_results import graded, results_of, rows
from small_batches import CLASSES, batch_of_balls

from pipeline.batch.layout import Results
from pipeline.batch.records import read_record, write_record

BY, WHY = "A. Huber", "hard at the suture"


@pytest.fixture
def batch(tmp_path):
    return batch_of_balls(tmp_path / "batch", "A", "B", settings=CLASSES)


@pytest.fixture
def results(drupe, batch):
    out = results_of(batch / "results", [graded("A", 0.3), graded("B", 0.8)])
    assert drupe("report", out, "--lang", "de").status == 0
    return out


@pytest.fixture
def judge(drupe, results):
    def run(fruit="A", judged="firm", by=BY, why=WHY, out=results):
        return drupe("judge", out, fruit, "--class", judged, "--by", by, "--why", why)

    return run


def page_of(results):
    return (results / "report.html").read_text("utf-8").replace("\u00a0", " ").replace("\\u003c", "<")


def trail(results):
    return (results / "verdicts.jsonl").read_text("utf-8").splitlines(keepends=True)


def test_a_verdict_is_beside_e_in_ranking_and_report_and_changes_no_other_cell(judge, results):
    before = rows(results)
    done = judge()
    assert done.status == 0
    assert done.out == f"A: firm, by {BY} (E stays 0.300 ± 0.015 MPa); kept in {results / 'verdicts.jsonl'}\n"
    after = rows(results)
    judged = {name: cell for name, cell in after["A"].items() if name.startswith("judged_")}
    time_utc = judged.pop("judged_utc")
    assert judged == {
        "judged_class": "firm", "judged_by": BY, "judged_why": WHY, "judged_E_MPa": "0.3",
        "judged_earlier": "",
    }  # fmt: skip
    assert {name: after["A"][name] for name in before["A"] if not name.startswith("judged_")} == {
        name: cell for name, cell in before["A"].items() if not name.startswith("judged_")
    }
    assert after["A"]["maturity"] == "soft"
    assert after["B"] == before["B"]
    page = page_of(results)
    assert '<html lang="de">' in page
    day = f"{time_utc[:10]} {time_utc[11:16]} UTC"
    assert f"{BY} hat sie am {day} als firm beurteilt (E = 0,300 ± 0,015 MPa): {WHY}." in page
    assert f"<td>{BY}: firm</td>" in page


def test_the_trail_says_who_when_what_why_and_lines_are_only_added(judge, results):
    judge()
    first = trail(results)
    judge(judged="soft", by="C. Roth", why="yields to the thumb")
    both = trail(results)
    assert both[:1] == first
    said = [json.loads(line) for line in both]
    assert [(judgement["by"], judgement["judged_class"], judgement["E_MPa"]) for judgement in said] == [
        (BY, "firm", 0.3), ("C. Roth", "soft", 0.3)
    ]  # fmt: skip
    assert all(
        judgement["at_utc"].endswith("Z") and judgement["drupe"] and judgement["key"] == "k"
        for judgement in said
    )
    chain = [hashlib.sha256("".join(both[:k]).encode()).hexdigest() for k in range(2)]
    assert [judgement["after"] for judgement in said] == chain
    assert rows(results)["A"]["judged_by"] == "C. Roth"
    assert page_of(results).count("<b>Urteil einer Person:</b>") == 2


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: [lines[0].replace("firm", "soft"), lines[1]],
        lambda lines: lines[1:],
        lambda lines: [lines[0], lines[1].rstrip("\n")],
        lambda lines: [lines[0], "{}\n"],
    ],
    ids=["another class", "the first removed", "half a line", "no verdict"],
)
def test_a_changed_trail_is_named_in_the_report_and_nothing_is_added_to_it(drupe, judge, results, change):
    judge()
    judge(fruit="B")
    changed = "".join(change(trail(results)))
    (results / "verdicts.jsonl").write_text(changed, "utf-8")
    done = judge()
    assert done.status == 2
    assert "verdicts.jsonl: line " in done.err
    assert "Restore it from a copy" in done.err
    assert (results / "verdicts.jsonl").read_text("utf-8") == changed
    assert drupe("report", results).status == 0
    assert "verdicts.jsonl: line " in page_of(results)


def test_a_later_grading_keeps_the_verdict_and_says_that_it_is_about_an_earlier_revision(
    drupe, judge, results
):
    judge()
    path = Results(results).fruit("A").record
    record = read_record(path)
    modulus = record.modulus.model_copy(update={"E_MPa": 0.45})
    write_record(path, record.model_copy(update={"key": "k2", "modulus": modulus}))
    assert drupe("report", results, "--lang", "en").status == 0
    row = rows(results)["A"]
    assert (row["E_MPa"], row["judged_E_MPa"], row["judged_earlier"]) == ("0.45", "0.3", "true")
    assert "The verdict is about an earlier revision of this result." in page_of(results)
    judge(why="cut open")
    assert rows(results)["A"]["judged_earlier"] == ""


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_a_class_of_earlier_results_with_separate_accents_is_the_same_class(drupe, tmp_path, form):
    settings = CLASSES.replace('"soft"', '"für jetzt"')
    batch = batch_of_balls(tmp_path / "batch", "A", settings=settings)
    classes = [{"name": normalize("NFD", "für jetzt"), "E_max_MPa": 0.5}, {"name": "firm", "E_max_MPa": None}]
    out = results_of(batch / "results", [graded("A", 0.3)], grading={"classes": classes})
    words = ("--class", normalize(form, "für jetzt"), "--by", BY, "--why", WHY)
    drupe("judge", out, "A", *words, status=0)
    assert rows(out)["A"]["judged_class"] == "f\u00fcr jetzt"


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"judged": "frim"}, '--class: found "frim"; did you mean "firm"? known classes: soft, firm.'),
        ({"judged": "zzz"}, '--class: found "zzz"; choose a known class: soft, firm.'),
        ({"fruit": "C"}, 'FRUIT: found "C"; choose a known fruit: A, B.'),
        ({"fruit": "AA"}, 'FRUIT: found "AA"; did you mean "A"? known fruit: A, B.'),
        ({"fruit": "../A"}, 'FRUIT: found "../A"; '),
        ({"by": " "}, "--by: has 0 characters; expected 1 to 80."),
        ({"why": "x" * 1001}, "--why: has 1001 characters; expected 1 to 1000."),
    ],
)
def test_what_cannot_be_kept_is_said_and_nothing_is_written(judge, results, wrong, says):
    done = judge(**wrong)
    assert done.status == 2
    assert says in done.err
    assert not (results / "verdicts.jsonl").exists()


def test_a_formula_or_markup_in_a_verdict_runs_nowhere(judge, results):
    judge(by="=cmd|' /C calc'!A0", why="<script>alert(1)</script>")
    assert rows(results)["A"]["judged_by"] == "'=cmd|' /C calc'!A0"
    text = (results / "report.html").read_text("utf-8")
    assert "<script>alert(1)" not in text
    details = re.search(r'<script type="application/json" id="details">(.*?)</script>', text, re.DOTALL)[1]
    opened = json.loads(details.splitlines()[0])["html"]
    assert "<script" not in opened
    assert "&lt;script&gt;alert(1)" in opened
