"""Two processes that write into the same results: one waits for the other, and nothing is lost."""

import errno
import fcntl
import multiprocessing
import os
import time
from contextlib import contextmanager

import pytest

from pipeline.batch.layout import FruitResults, write_whole
from pipeline.batch.write_guard import LOCK, is_held, require_made_by_drupe, results_lock
from pipeline.files.manifest import LIST_LOCK, in_the_way, writing_alone
from pipeline.problem import BatchRefused

SPAWN = multiprocessing.get_context("spawn")


def write_all(root, which, refused):
    """The files of a fruit, again and again."""
    fruit = FruitResults(root)
    fruit.claim()
    for k in range(20):
        for path in (fruit.record, fruit.fruit_ply, fruit.picture):
            try:
                write_whole(path, f"{which} {k}")
            except OSError as error:
                refused.put(str(error))
    refused.put("")


def test_two_workers_on_one_fruit_refuse_each_other_nothing(tmp_path):
    refused = SPAWN.Queue()
    workers = [SPAWN.Process(target=write_all, args=(tmp_path, which, refused)) for which in range(2)]
    for worker in workers:
        worker.start()
    said = []
    while said.count("") < 2:
        said.append(refused.get(timeout=60))
    for worker in workers:
        worker.join()
    assert said == ["", ""]
    assert not list(in_the_way(FruitResults(tmp_path).files))
    assert {path.name for path in tmp_path.iterdir()} == {
        *("record.json", "fruit.ply", "mesh.webp"),
        *(".written.json", LIST_LOCK),
    }


def hold(lock, root, begun):
    """Never lets go."""
    with lock(root):
        begun.set()
        time.sleep(600)


@contextmanager
def held_by_another(lock, root):
    """A process that holds the lock of a folder and does not end."""
    begun = SPAWN.Event()
    process = SPAWN.Process(target=hold, args=(lock, root, begun))
    process.start()
    assert begun.wait(60)
    try:
        yield process
    finally:
        process.kill()
        process.join()


def test_one_that_was_killed_holds_up_nobody(tmp_path):
    FruitResults(tmp_path).claim()
    with held_by_another(writing_alone, tmp_path):
        pass
    began = time.monotonic()
    write_whole(tmp_path / "record.json", "new")
    assert time.monotonic() - began < 5
    assert not list(in_the_way(FruitResults(tmp_path).files))


def test_without_locks_or_in_place_of_one_a_folder_it_is_written_all_the_same(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    with monkeypatch.context() as without:
        without.setattr(fcntl, "flock", none)
        FruitResults(tmp_path).claim()
        write_whole(tmp_path / "record.json", "first")
        with results_lock(tmp_path):
            assert not is_held(tmp_path)
    (tmp_path / LIST_LOCK).unlink()
    (tmp_path / LIST_LOCK).mkdir()
    write_whole(tmp_path / "record.json", "second")
    assert (tmp_path / "record.json").read_text() == "second"


@pytest.mark.parametrize("left", [LIST_LOCK, LOCK, "..written.json.drupe-part-0a1b2c3d"])
def test_a_run_killed_as_it_began_leaves_a_folder_that_the_next_takes(tmp_path, left):
    (tmp_path / left).touch()
    require_made_by_drupe(tmp_path, "--out")


def test_results_that_another_run_writes_are_refused_until_it_ends(tmp_path):
    with held_by_another(results_lock, tmp_path):
        assert is_held(tmp_path)
        with (
            pytest.raises(BatchRefused, match=r"another run is writing here and holds \.lock"),
            results_lock(tmp_path),
        ):
            pass
    with results_lock(tmp_path):
        assert is_held(tmp_path)
