"""A recording in which the HDF5 library would never come to an end is refused in seconds."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import pytest

import tactile.io.hdf5_faults
import tactile.io.limited_process
from tactile.io.hdf5_faults import texts_fault
from tactile.io.recording import read_recording
from tactile.tactile_failure import TactileFailure

SHIPPED = (
    Path(__file__).parents[2] / "samples" / "data" / "nectarines" / "fruits" / "N01" / "grasps" / "grasp-1.h5"
)


@pytest.fixture(autouse=True)
def _no_contents_are_known(monkeypatch):
    monkeypatch.setattr(tactile.io.hdf5_faults, "_read_through", set())


def with_a_broken_heap(path):
    """The length of the category, kept before it in the file's heap, made not to lead to the next text."""
    data = bytearray(shutil.copy(SHIPPED, path).read_bytes())
    data[data.index(b"nectarine", data.index(b"GCOL")) - 8] = 215
    path.write_bytes(data)
    return path


def test_a_sound_file_can_be_read_at_once():
    began = time.monotonic()
    assert not texts_fault(SHIPPED)
    assert time.monotonic() - began < 5


def test_a_heap_without_an_end_is_refused(tmp_path, monkeypatch):
    path = with_a_broken_heap(tmp_path / "grasp-1.h5")
    assert "in 1 s" in texts_fault(path, patience_s=1.0)
    monkeypatch.setattr(tactile.io.hdf5_faults.texts_fault, "__kwdefaults__", {"patience_s": 1.0})
    with pytest.raises(TactileFailure, match=r"grasp-1\.h5") as refused:
        read_recording(path)
    assert "copy it again" in str(refused.value)


def test_contents_that_were_read_through_are_not_tried_again_and_changed_ones_are(tmp_path, monkeypatch):
    path = tmp_path / "grasp-1.h5"
    shutil.copy(SHIPPED, path)
    assert not texts_fault(path)
    monkeypatch.setattr(tactile.io.hdf5_faults, "tried", None)
    assert not texts_fault(path)
    monkeypatch.undo()
    assert "in 1 s" in texts_fault(with_a_broken_heap(path), patience_s=1.0)


def test_contents_whose_reading_failed_are_tried_again(monkeypatch):
    def failing(path, tell):
        raise OSError("no file can be opened now")

    with monkeypatch.context() as patch:
        patch.setattr(tactile.io.hdf5_faults, "_read", failing)
        assert texts_fault(SHIPPED) == ""
    assert not tactile.io.hdf5_faults._read_through
    assert texts_fault(SHIPPED) == ""
    assert tactile.io.hdf5_faults._read_through


def test_links_are_not_followed_to_find_out(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target = with_a_broken_heap(tmp_path / "elsewhere" / "other.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["pads"] = h5py.ExternalLink(str(target), "/pads")
    assert not texts_fault(tmp_path / "a.h5", patience_s=1.0)


def test_a_sound_file_can_be_read_where_ended_processes_are_not_kept():
    """As under a service that ignores SIGCHLD: the system forgets the child before it can be asked after."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        assert not texts_fault(SHIPPED)
    finally:
        signal.signal(signal.SIGCHLD, before)


def is_running(pid):
    """Whether it has neither ended nor waits to be asked after."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def ends_within(pid, seconds):
    end = time.monotonic() + seconds
    while is_running(pid) and time.monotonic() < end:
        time.sleep(0.05)
    return not is_running(pid)


def test_an_interrupted_check_leaves_no_process(tmp_path, monkeypatch):
    path = with_a_broken_heap(tmp_path / "grasp-1.h5")
    fork, children = os.fork, []

    def refuse():
        children.append(fork())
        return children[-1]

    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fork", refuse)
    monkeypatch.setattr(tactile.io.limited_process.time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        texts_fault(path)
    monkeypatch.undo()
    (child,) = children
    with suppress(ProcessLookupError):
        os.kill(child, 0)  # not even as one that waits to be asked after
        os.kill(child, signal.SIGKILL)
        pytest.fail("the process that reads the texts is still there")


CHECKING = """
import os, sys
from pathlib import Path
from tactile.io.hdf5_faults import texts_fault
fork = os.fork
def refuse():
    child = fork()
    if child:
        print(child, flush=True)
    return child
os.fork = refuse
texts_fault(Path(sys.argv[1]), patience_s=float(sys.argv[2]))
"""


@contextmanager
def checking(path, patience_s):
    """A run that checks the file, and the process that reads its texts."""
    command = [sys.executable, "-c", CHECKING, str(path), str(patience_s)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        child = int(run.stdout.readline())
        try:
            yield run, child
        finally:
            run.kill()
            if is_running(child):
                os.kill(child, signal.SIGKILL)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc and the signal of a parent's death are Linux's")
def test_a_killed_run_takes_the_process_along(tmp_path):
    with checking(with_a_broken_heap(tmp_path / "grasp-1.h5"), 100.0) as (run, child):
        time.sleep(0.3)
        assert is_running(child)
        run.kill()
        assert ends_within(child, 10)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_process_that_nobody_ends_has_so_much_processor_time_and_no_more(tmp_path):
    with checking(with_a_broken_heap(tmp_path / "grasp-1.h5"), 0.5) as (run, child):
        run.send_signal(signal.SIGSTOP)
        assert ends_within(child, 60)  # of wall time: 2 s of processor time on a loaded machine
