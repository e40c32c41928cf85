"""The page of `drupe watch` is for this machine, by its token, read only."""

import http.client
import time
from contextlib import closing
from urllib.parse import urlsplit

import pytest

from pipeline.batch.layout import Results, write_whole
from pipeline.problem import BatchRefused
from pipeline.watch.page_server import PageServer


def ask(server, path, *, host=None, method="GET"):
    """Status, headers and body of one answer."""
    address = urlsplit(server.address)
    with closing(http.client.HTTPConnection(address.hostname, address.port, timeout=10)) as connection:
        connection.putrequest(method, path, skip_host=True)
        connection.putheader("Host", host or address.netloc)
        connection.endheaders()
        with connection.getresponse() as answer:
            return answer.status, dict(answer.getheaders()), answer.read()


@pytest.fixture
def server(tmp_path):
    results = Results(tmp_path / "results")
    results.claim()
    with PageServer(results) as serving:
        serving.show("<p>first</p>")
        yield serving


def test_the_page_is_given_to_who_knows_its_token_alone(server):
    own = urlsplit(server.address).path
    assert len(own) > 20
    status, headers, body = ask(server, own)
    assert (status, body) == (200, b"<p>first</p>")
    assert headers["x-frame-options"] == "DENY"
    assert ask(server, "/")[0] == 404
    assert ask(server, "/wrong/")[0] == 404
    assert ask(server, own, host="evil.example")[0] == 400
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert ask(server, own, method=method)[0] == 405


def test_of_the_results_only_what_drupe_wrote_is_given(server, tmp_path):
    own = urlsplit(server.address).path
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
    assert ask(server, own + "report.html")[2] == b"<p>report</p>"
    assert ask(server, own + f"fruits/N01/{fruit.picture.name}")[2] == b"png"
    for path in (
        "fruits/N01/mine.png", "linked.json", "../secret.json", "%2e%2e/secret.json", ".written.json",
        "fruits/N01/.written.json", "fruits/N01", "fruits/../../secret.json", "report.html%00.png",
        "//etc/passwd",
    ):  # fmt: skip
        assert ask(server, own + path)[0] == 404, path


def test_news_reach_an_open_page_within_a_second(server):
    address = urlsplit(server.address)
    with closing(http.client.HTTPConnection(address.hostname, address.port, timeout=10)) as connection:
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
    assert ask(server, address.path)[2] == b"<p>second</p>"


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
