"""The page of `drupe watch` is for this machine, by its token, read only."""

import socket
import time
from contextlib import ExitStack, closing
from urllib.parse import urlsplit

import pytest
import uvicorn
from page_client import answer_to, connected

from pipeline.batch.layout import Results, write_whole
from pipeline.problem import BatchRefused
from pipeline.watch import page_server
from pipeline.watch.page_server import LOOPBACK, MOST_CONNECTIONS, PageServer


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
