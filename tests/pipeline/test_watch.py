"""`drupe watch`: fruit are graded as they arrive; the page is for this machine, by its token, read only."""

import csv
import http.client
import shutil
import time
from contextlib import closing
from urllib.parse import urlsplit

import pytest
from rich.console import Console

from pipeline.batch.layout import Results, write_whole
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import FruitRecord, ModulusRecord, write_record
from pipeline.problem import BatchRefused
from pipeline.run import grading
from pipeline.run.fruit_records import ended_record
from pipeline.watch.page_server import PageServer
from pipeline.watch.watching import BatchWatch, WatchOptions
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh
from reports.kiosk_page import kiosk_html

HEAD = 'category = "nectarine"\n[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.5\n'


@pytest.fixture
def batch(tmp_path):
    """No row in fruits.csv, no fruit yet."""
    root = tmp_path / "monday"
    (root / "fruits").mkdir(parents=True)
    (root / "batch.toml").write_text(HEAD + '[[grading.classes]]\nname = "firm"\n')
    (root / "fruits.csv").write_text("fruit_id,height_mm\n")
    return root


def put(batch, name, *, recording=True):
    """A fruit's files, as a gripper leaves them."""
    folder = batch / "fruits" / name
    (folder / "grasps").mkdir(parents=True, exist_ok=True)
    directions, faces = ball(2)
    write_mesh(folder / "fruit.ply", 28 * directions, faces)
    if recording:
        (folder / "grasps" / "grasp-1.h5").write_text(f"of {name}")


@pytest.fixture
def watched(batch, monkeypatch):
    """Watches with a clock that sleeping moves; `during` are done one at each sleep; the work is instant."""
    worked, shown, time_s = [], [], [0.0]

    def work(todo, records, _so_far, **_):
        for fruit_id, task in todo:
            worked.append(fruit_id)
            if fruit_id.startswith("crash"):
                records[fruit_id] = ended_record(task, Outcome.CRASHED, "signal 9")
                continue
            task.results.claim()
            modulus = ModulusRecord(E_MPa=0.1 + 0.1 * len(records), E_sd_MPa=0.01)
            records[fruit_id] = FruitRecord(
                fruit_id=fruit_id, outcome="graded", key=task.key, given=task.given, modulus=modulus
            )
            write_record(task.results.record, records[fruit_id])

    monkeypatch.setattr(grading, "_work", work)

    def run(*during, idle_s=30.0, settle_s=2.0, jobs=1):
        steps = list(during)

        def sleep(seconds):
            time_s[0] += seconds
            if steps:
                steps.pop(0)()

        options = WatchOptions(
            out=batch / "results", jobs=jobs, time_limit_s=60, screen=False, settle_s=settle_s, idle_s=idle_s
        )
        console = Console(quiet=True)
        watch = BatchWatch(
            root=batch,
            options=options,
            console=console,
            show=shown.append,
            clock=lambda: time_s[0],
            sleep=sleep,
        )
        status = watch.run()
        assert not steps
        return status

    run.worked, run.shown = worked, shown
    return run


def rows(batch):
    with (batch / "results" / "ranking.csv").open() as file:
        return {row["fruit_id"]: row for row in csv.DictReader(file)}


def test_fruit_are_graded_as_they_come_and_shown_at_once(batch, watched):
    status = watched(lambda: put(batch, "B"), *[lambda: None] * 6, lambda: put(batch, "A"))
    assert status == 0
    assert watched.worked == ["B", "A"]
    assert {name: row["maturity"] for name, row in rows(batch).items()} == {"A": "soft", "B": "soft"}
    assert [entry.recent for entry in watched.shown if entry.batch][-1] == ("A", "B")
    working = [entry.working for entry in watched.shown if entry.working]
    assert working == [("B",), ("A",)]
    assert (batch / "fruits.csv").read_text() == "fruit_id,height_mm\n"


def test_files_that_still_arrive_are_waited_for(batch, watched):
    put(batch, "A", recording=False)
    photo = batch / "fruits" / "A" / "grasps" / "grasp-1.h5"

    def grow():
        with photo.open("a") as file:
            file.write("more")

    watched(*[lambda: None] * 8, *[grow] * 8)
    assert watched.worked == ["A"]
    waiting = [entry.waiting for entry in watched.shown]
    assert waiting[0] == (("A", "a recording in grasps/"),)
    assert waiting[-1] == ()


def test_a_fruit_without_shape_yet_holds_up_no_other(batch, watched):
    """Photos without a mat or a height would stop the whole batch, if it were one of it already."""
    (batch / "fruits" / "B" / "grasps").mkdir(parents=True)
    (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_text("of B")
    (batch / "fruits.csv").write_text("fruit_id,height_mm\nA,\nC,\n")
    put(batch, "A")
    watched()
    assert watched.worked == ["A"]
    assert watched.shown[-1].waiting == (("B", "photos or fruit.ply"),)
    assert watched.shown[-1].expected == 1


def test_watching_ends_where_the_batch_cannot_be_graded(batch, watched):
    put(batch, "A")
    (batch / "batch.toml").write_text("category = 3\n")
    assert watched() == 0
    assert not watched.worked


def test_a_fruit_that_changes_is_graded_again_and_one_that_does_not_is_not(batch, watched):
    put(batch, "A")
    put(batch, "B")
    watched()
    assert sorted(watched.worked) == ["A", "B"]
    watched(lambda: (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again"))
    assert sorted(watched.worked) == ["A", "B", "B"]
    assert len(rows(batch)) == 2


def test_a_fruit_that_crashed_is_not_tried_at_each_newcomer(batch, watched):
    put(batch, "crash-1")
    status = watched(
        *[lambda: None] * 6, lambda: put(batch, "A"), *[lambda: None] * 6, lambda: put(batch, "B")
    )
    assert watched.worked == ["crash-1", "A", "B"]
    assert status == 3
    last = kiosk_html(watched.shown[-1])
    assert '<p class="id">B</p>' in last


def test_a_fault_in_the_settings_is_shown_and_mended_while_it_watches(batch, watched):
    put(batch, "A")
    good = (batch / "batch.toml").read_text()
    (batch / "batch.toml").write_text('category = "nectarin"\n')
    watched(*[lambda: None] * 6, lambda: (batch / "batch.toml").write_text(good))
    assert any("nectarin" in problem for entry in watched.shown for problem in entry.problems)
    assert watched.shown[-1].problems == ()
    assert watched.worked == ["A"]


def test_after_a_change_of_settings_all_fruit_are_taken_up_in_one_go(batch, watched):
    for name in "ABC":
        put(batch, name)
    (batch / "notes.txt").write_text("of no account")
    change = (batch / "batch.toml").read_text().replace("0.5", "0.15")
    watched(
        *[lambda: None] * 16,
        lambda: (batch / "notes.txt").write_text("changed"),
        *[lambda: None] * 4,
        lambda: (batch / "batch.toml").write_text(change),
    )
    assert watched.worked == ["A", "B", "C"]
    assert [entry.working for entry in watched.shown if entry.working] == [
        ("A",),
        ("B",),
        ("C",),
        ("A", "B", "C"),
    ]
    assert {row["maturity"] for row in rows(batch).values()} == {"soft", "firm"}


def test_a_deleted_fruit_costs_nothing(batch, watched):
    put(batch, "A")
    put(batch, "B")
    watched(*[lambda: None] * 12, lambda: shutil.rmtree(batch / "fruits" / "A"), lambda: put(batch, "C"))
    assert sorted(rows(batch)) == ["B", "C"]


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
