"""Verdicts on the page of `drupe watch`: behind its token, from its own form alone, shown at once."""

from datetime import UTC, datetime
from urllib.parse import urlencode, urlsplit

import pytest
from graded_results import graded, results_of
from page_client import answer_to, connected

from pipeline.batch.layout import Results
from pipeline.batch.verdicts import read_trail
from pipeline.watch.device_login import MOST_FORM_BYTES
from pipeline.watch.page_server import PageServer
from pipeline.watch.verdict_desk import VerdictDesk
from reports.entries import BatchEntry, FruitEntry
from reports.kiosk_page import KioskEntry

FORM = {"class": "firm", "by": "A. Huber", "why": "hard at the suture"}
NOW = datetime(2026, 8, 14, 9, 30, tzinfo=UTC)


@pytest.fixture
def results(tmp_path):
    grading = {"classes": [{"name": "soft", "E_max_MPa": 0.5}, {"name": "firm"}]}
    return Results(results_of(tmp_path / "b" / "results", [graded("N 1", 0.3)], grading=grading))


@pytest.fixture
def calls():
    return []


@pytest.fixture
def server(results, calls):
    fruit = FruitEntry(fruit_id="N 1", ok=True, outcome="graded", rank=1, E_MPa=0.3, E_sd_MPa=0.015)
    batch = BatchEntry(
        name="b", category="nectarine", fruits=(fruit,), classes=(("soft", 0.5), ("firm", None)),
        started_utc=NOW, finished_utc=NOW, exit_status=None,
    )  # fmt: skip
    with PageServer(results) as serving:
        desk = VerdictDesk(
            results=results,
            language="en",
            show=serving.show,
            kept=lambda: calls.append("kept"),
            now=lambda: NOW,
        )
        serving.desk = desk
        desk.show_entry(KioskEntry(name="b", batch=batch, recent=("N 1",)))
        yield serving


def ask(server, path, form=None, **headers):
    """Status, place and text of one answer; with a form it is sent."""
    headers = {"Sec_Fetch_Site": "same-origin"} | headers
    status, answered, text = answer_to(connected(server), path, form, **headers)
    return status, answered.get("location"), text


def form_of(server):
    return urlsplit(server.address).path + "judge?fruit=N+1"


def test_a_verdict_given_on_the_page_is_kept_and_shown_at_once(server, results, calls):
    page = ask(server, urlsplit(server.address).path)[2]
    assert 'href="judge?fruit=N%201"' in page
    assert "<option>firm</option>" in ask(server, form_of(server))[2]
    assert ask(server, form_of(server), FORM)[:2] == (303, "./")
    (verdict,) = read_trail(results.verdicts).of_fruit["N 1"]
    assert (verdict.judged_class, verdict.by, verdict.why, verdict.E_MPa, verdict.at_utc) == (
        "firm", "A. Huber", "hard at the suture", 0.3, NOW
    )  # fmt: skip
    assert calls == ["kept"]
    page = ask(server, urlsplit(server.address).path)[2].replace("\u00a0", " ")
    assert (
        "A. Huber judged it firm on 2026-08-14 09:30 UTC (E = 0.300 ± 0.015 MPa): hard at the suture." in page
    )
    assert "0.300 ± 0.015 MPa</p>" in page


@pytest.mark.parametrize(
    ("path", "form", "headers"),
    [
        ("/wrong/judge?fruit=N+1", FORM, {}),
        (None, FORM, {"Sec_Fetch_Site": "cross-site"}),
        (None, {**FORM, "why": "x" * MOST_FORM_BYTES}, {}),
        (None, {f"field{k}": "x" for k in range(11)}, {}),
    ],
    ids=["wrong token", "another site", "too long", "too many fields"],
)
def test_a_form_that_is_not_the_page_s_own_keeps_nothing(server, results, calls, path, form, headers):
    assert ask(server, path or form_of(server), form, **headers)[0] == 404
    assert not results.verdicts.exists()
    assert calls == []


def test_a_fruit_that_is_not_shown_has_no_form_and_takes_no_verdict(server, results):
    unknown = form_of(server).replace("N+1", "N+2")
    assert ask(server, unknown)[0] == 404
    assert ask(server, unknown, FORM)[0] == 404
    assert not results.verdicts.exists()


@pytest.mark.parametrize(
    ("code", "place", "said"),
    [
        ("drupe/b/N%201", "judge?fruit=N%201", ""),
        ("DRUPE/b/N%201\r", "judge?fruit=N%201", ""),
        ("N 1", "judge?fruit=N%201", ""),
        ("drupe/b/", "report.html", ""),
        ("drupe/c/N%201", None, "This code is of lot c; the page shows lot b."),
        ("<b>N 2", None, "The page shows no fruit &lt;b&gt;N 2."),
    ],
)
def test_a_scanned_code_leads_to_the_fruit_s_form_or_the_lot_s_report(server, code, place, said):
    status, led_to, page = ask(server, f"{urlsplit(server.address).path}scan?{urlencode({'code': code})}")
    assert (status, led_to) == ((303, place) if place else (404, None))
    assert said in page
    assert ask(server, f"/wrong/scan?{urlencode({'code': code})}")[0] == 404


def test_a_form_with_a_fault_comes_back_with_what_was_written(server, results):
    status, _, page = ask(server, form_of(server), {**FORM, "class": "frim"})
    assert status == 422
    assert "Not kept: found &#34;frim&#34;; did you mean &#34;firm&#34;?" in page
    assert 'value="A. Huber"' in page
    assert not results.verdicts.exists()


def test_without_a_desk_the_page_takes_nothing(results):
    with PageServer(results) as serving:
        assert ask(serving, form_of(serving), FORM)[0] == 404
