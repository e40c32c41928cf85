"""Locks: a process that keeps one is named, and nobody waits for it without an end."""

import os
import subprocess
import sys

import pytest

from pipeline.batch.results_lock import LOCK, results_lock
from pipeline.files.lock_file import holder_of, locked, locked_within, open_lock
from pipeline.problem import BatchRefused

HOLDING = """
import fcntl, os, sys, time
handle = os.open(sys.argv[1], os.O_RDONLY)
fcntl.flock(handle, fcntl.LOCK_EX)
print("held", flush=True)
time.sleep(60)
"""
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="/proc/locks is Linux's")


@pytest.fixture
def held_by_a_reader():
    """Has another process open a path for reading alone and hold its lock; gives its number."""
    started = []

    def hold(path):
        run = subprocess.Popen([sys.executable, "-c", HOLDING, str(path)], stdout=subprocess.PIPE, text=True)
        started.append(run)
        assert run.stdout.readline() == "held\n"
        return run.pid

    yield hold
    for run in started:
        run.kill()
        run.communicate()


@on_linux
def test_a_results_folder_that_is_in_use_names_its_lock_and_the_process(tmp_path, held_by_a_reader):
    (tmp_path / LOCK).touch()
    holder = held_by_a_reader(tmp_path / LOCK)
    with (
        pytest.raises(
            BatchRefused, match=rf"another run is writing here \(process {holder}, .*holds \.lock;"
        ),
        results_lock(tmp_path),
    ):
        pass


@on_linux
def test_a_lock_that_is_let_go_is_taken(tmp_path, held_by_a_reader):
    lock = open_lock(tmp_path / LOCK)
    holder = held_by_a_reader(tmp_path / LOCK)
    assert not locked(lock)
    assert f"process {holder}" in holder_of(lock)
    os.kill(holder, 9)
    assert locked_within(lock, 5.0)
    os.close(lock)


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o600), (0o002, 0o660), (0o077, 0o600), (0o000, 0o666)])
def test_who_may_not_write_a_lock_cannot_open_it(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        os.close(open_lock(tmp_path / LOCK))
        assert (tmp_path / LOCK).stat().st_mode & 0o777 == mode
        (tmp_path / LOCK).chmod(0o666 & ~umask)
        os.close(open_lock(tmp_path / LOCK))
        assert (tmp_path / LOCK).stat().st_mode & 0o777 == mode
    finally:
        os.umask(before)
