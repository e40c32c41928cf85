"""The page of `drupe watch`: for this machine, by its token; verdicts from its own form alone."""

import socket
import time
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from urllib.parse import urlencode, urlsplit

import pytest
import uvicorn
from graded_results import graded, results_of
from page_client import answer_to, connected

from pipeline.batch.layout import Results, write_whole
from pipeline.batch.verdicts import read_trail
from pipeline.problem import BatchRefused
from pipeline.watch import page_server
from pipeline.watch.device_login import MOST_FORM_BYTES
from pipeline.watch.page_server import LOOPBACK, MOST_CONNECTIONS, PageServer
from pipeline.watch.verdict_desk import VerdictDesk
from reports.entries import BatchEntry, FruitEntry
from reports.kiosk_page import KioskEntry


def ask(server, path, **how):
    return answer_to(connected(server), path, **how)


@pytest.fixture
def server(tmp_path):
    results = Results(tmp_path / "results")
    results.claim()
    with PageServer(results) as serving:
        serving.show("<p>first</p>")
        yield serving


def test_the_page_is_given_to_who_knows_its_token_alone(server):
    address = urlsplit(server.address).path
    assert len(address) > 20
    status, headers, body = ask(server, address)
    assert (status, body) == (200, "<p>first</p>")
    assert headers["x-frame-options"] == "DENY"
    assert ask(server, "/")[0] == 404
    assert ask(server, "/wrong/")[0] == 404
    assert ask(server, address, Host="evil.example")[0] == 400
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert ask(server, address, method=method)[0] == 405


def test_of_the_results_only_what_drupe_wrote_is_given(server, tmp_path):
    address = urlsplit(server.address).path
    results = Results(tmp_path / "results")
    fruit = results.fruit("N01")
    fruit.root.mkdir(parents=True)
    fruit.claim()
    write_whole(results.report, "<p>report</p>")
    write_whole(fruit.picture, b"png")
    (fruit.root / "mine.png").write_bytes(b"mine")
    secret = tmp_path / "secret.json"
    secret.write_text("{}")
    (results.root / "linked.json").symlink_to(secret)
    assert ask(server, address + "report.html")[2] == "<p>report</p>"
    assert ask(server, address + f"fruits/N01/{fruit.picture.name}")[2] == "png"
    for path in (
        "fruits/N01/mine.png", "linked.json", "../secret.json", "%2e%2e/secret.json", ".written.json",
        "fruits/N01/.written.json", "fruits/N01", "fruits/../../secret.json", "report.html%00.png",
        "//etc/passwd",
    ):  # fmt: skip
        assert ask(server, address + path)[0] == 404, path


def test_news_reach_an_open_page_within_a_second(server):
    address = urlsplit(server.address)
    with connected(server) as connection:
        connection.request("GET", address.path + "events")
        with connection.getresponse() as answer:
            assert answer.getheader("content-type").startswith("text/event-stream")
            assert answer.readline() == b"event: changed\n"
            for _ in range(2):
                answer.readline()
            began = time.monotonic()
            server.show("<p>second</p>")
            assert answer.readline() == b"event: changed\n"
            assert time.monotonic() - began < 1.0
    assert ask(server, address.path)[2] == "<p>second</p>"


def test_a_port_that_is_taken_is_said(server, tmp_path):
    taken = urlsplit(server.address).port
    with pytest.raises(BatchRefused, match=f"--port {taken}"):
        PageServer(Results(tmp_path / "other"), port=taken)


def test_a_server_that_does_not_start_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: None)
    server = PageServer(Results(tmp_path / "results"))
    with pytest.raises(BatchRefused, match="the page of drupe watch: did not start"):
        server.__enter__()
    assert server._socket.fileno() == -1


def test_a_request_whose_bytes_come_one_by_one_is_ended_in_time(tmp_path, monkeypatch):
    monkeypatch.setattr(page_server, "REQUEST_S", 0.3)
    with (
        PageServer(Results(tmp_path / "results")) as server,
        closing(socket.create_connection((LOOPBACK, urlsplit(server.address).port), timeout=10)) as slow,
    ):
        slow.settimeout(0.05)
        ended = None
        for _ in range(100):
            try:
                slow.sendall(b"G")
                ended = slow.recv(1)
                break
            except TimeoutError:
                continue
            except ConnectionError as error:
                ended = error
                break
        assert ended == b"" or isinstance(ended, ConnectionError)


def test_open_pages_stay_and_idle_connections_give_their_place_back(tmp_path, monkeypatch):
    monkeypatch.setattr(page_server, "REQUEST_S", 0.5)
    with PageServer(Results(tmp_path / "results")) as server, ExitStack() as held:
        server.show("<p>page</p>")
        address = urlsplit(server.address)
        connection = held.enter_context(connected(server))
        connection.request("GET", address.path + "events")
        open_page = connection.getresponse()
        for _ in range(MOST_CONNECTIONS):
            held.enter_context(closing(socket.create_connection((LOOPBACK, address.port), timeout=10)))
        with pytest.raises(OSError, match=r"reset|closed|Broken pipe"):
            ask(server, address.path)
        time.sleep(1.0)
        assert ask(server, address.path)[2] == "<p>page</p>"
        assert open_page.readline() == b"event: changed\n"


@pytest.mark.parametrize("fault", [OSError(24, "Too many open files"), RuntimeError("broken"), SystemExit(1)])
def test_a_page_that_stops_is_told(tmp_path, monkeypatch, fault):
    messages = []

    def run(self, sockets):
        self.started = True
        raise fault

    monkeypatch.setattr(uvicorn.Server, "run", run)
    with PageServer(Results(tmp_path / "results"), tell=messages.append) as server:
        server._thread.join(10)
    (sentence,) = messages
    assert sentence.startswith("the page stopped (")
    assert "grading continues" in sentence


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
def desk_server(results, calls):
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


def ask_desk(desk_server, path, form=None, **headers):
    """Status, place and text of one answer; with a form it is sent."""
    headers = {"Sec_Fetch_Site": "same-origin"} | headers
    status, answered, text = answer_to(connected(desk_server), path, form, **headers)
    return status, answered.get("location"), text


def form_of(desk_server):
    return urlsplit(desk_server.address).path + "judge?fruit=N+1"


def test_a_verdict_given_on_the_page_is_kept_and_shown_at_once(desk_server, results, calls):
    page = ask_desk(desk_server, urlsplit(desk_server.address).path)[2]
    assert 'href="judge?fruit=N%201"' in page
    assert "<option>firm</option>" in ask_desk(desk_server, form_of(desk_server))[2]
    assert ask_desk(desk_server, form_of(desk_server), FORM)[:2] == (303, "./")
    (verdict,) = read_trail(results.verdicts).of_fruit["N 1"]
    assert (verdict.judged_class, verdict.by, verdict.why, verdict.E_MPa, verdict.at_utc) == (
        "firm", "A. Huber", "hard at the suture", 0.3, NOW
    )  # fmt: skip
    assert calls == ["kept"]
    page = ask_desk(desk_server, urlsplit(desk_server.address).path)[2].replace("\u00a0", " ")
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
def test_a_form_that_is_not_the_page_s_own_keeps_nothing(desk_server, results, calls, path, form, headers):
    assert ask_desk(desk_server, path or form_of(desk_server), form, **headers)[0] == 404
    assert not results.verdicts.exists()
    assert calls == []


def test_a_fruit_that_is_not_shown_has_no_form_and_takes_no_verdict(desk_server, results):
    unknown = form_of(desk_server).replace("N+1", "N+2")
    assert ask_desk(desk_server, unknown)[0] == 404
    assert ask_desk(desk_server, unknown, FORM)[0] == 404
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
def test_a_scanned_code_leads_to_the_fruit_s_form_or_the_lot_s_report(desk_server, code, place, said):
    status, led_to, page = ask_desk(
        desk_server, f"{urlsplit(desk_server.address).path}scan?{urlencode({'code': code})}"
    )
    assert (status, led_to) == ((303, place) if place else (404, None))
    assert said in page
    assert ask_desk(desk_server, f"/wrong/scan?{urlencode({'code': code})}")[0] == 404


def test_a_form_with_a_fault_comes_back_with_what_was_written(desk_server, results):
    status, _, page = ask_desk(desk_server, form_of(desk_server), {**FORM, "class": "frim"})
    assert status == 422
    assert "Not kept: found &#34;frim&#34;; did you mean &#34;firm&#34;?" in page
    assert 'value="A. Huber"' in page
    assert not results.verdicts.exists()


def test_without_a_desk_the_page_takes_nothing(results):
    with PageServer(results) as serving:
        assert ask_desk(serving, form_of(serving), FORM)[0] == 404
