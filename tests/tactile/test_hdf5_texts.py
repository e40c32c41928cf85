"""A recording in which the HDF5 library would never come to an end is refused in seconds."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import h5py
import pytest

import tactile.readers.hdf5_file
import tactile.readers.limited_process
from tactile.readers.hdf5_file import require_end
from tactile.readers.recording import read_recording
from tactile.tactile_failure import TactileFailure

SHIPPED = (
    Path(__file__).parents[2] / "samples" / "data" / "nectarines" / "fruits" / "N01" / "grasps" / "grasp-1.h5"
)


@pytest.fixture(autouse=True)
def _no_contents_are_known(monkeypatch):
    monkeypatch.setattr(tactile.readers.hdf5_file, "_read_through", set())


def with_a_broken_heap(path):
    """The length of the category, kept before it in the file's heap, made not to lead to the next text."""
    data = bytearray(shutil.copy(SHIPPED, path).read_bytes())
    data[data.index(b"nectarine", data.index(b"GCOL")) - 8] = 215
    path.write_bytes(data)
    return path


def test_a_sound_file_can_be_read_at_once():
    began = time.monotonic()
    require_end(SHIPPED)
    assert time.monotonic() - began < 5


def test_a_heap_without_an_end_is_refused(tmp_path, monkeypatch):
    path = with_a_broken_heap(tmp_path / "grasp-1.h5")
    monkeypatch.setattr(tactile.readers.hdf5_file.require_end, "__kwdefaults__", {"patience_s": 1.0})
    with pytest.raises(
        TactileFailure, match=r"grasp-1\.h5: attribute .* take more than 1 s to read"
    ) as refused:
        read_recording(path)
    assert "copy it again" in str(refused.value)


def test_contents_that_were_read_through_are_not_tried_again_and_changed_ones_are(tmp_path, monkeypatch):
    path = tmp_path / "grasp-1.h5"
    shutil.copy(SHIPPED, path)
    require_end(path)
    monkeypatch.setattr(tactile.readers.hdf5_file, "tried", None)
    require_end(path)
    monkeypatch.undo()
    with pytest.raises(TactileFailure, match="more than 1 s"):
        require_end(with_a_broken_heap(path), patience_s=1.0)


def test_links_are_not_followed_to_find_out(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target = with_a_broken_heap(tmp_path / "elsewhere" / "other.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["pads"] = h5py.ExternalLink(str(target), "/pads")
    require_end(tmp_path / "a.h5", patience_s=1.0)


def test_a_sound_file_can_be_read_where_ended_processes_are_not_kept():
    """As under a service that ignores SIGCHLD: the system forgets the child before it can be asked after."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        require_end(SHIPPED)
    finally:
        signal.signal(signal.SIGCHLD, before)


def is_running(pid):
    """Whether it has neither ended nor waits to be asked after."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_an_interrupted_check_leaves_no_process(tmp_path, monkeypatch):
    path = with_a_broken_heap(tmp_path / "grasp-1.h5")
    fork, children = os.fork, []

    def refuse():
        children.append(fork())
        return children[-1]

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fork", refuse)
    monkeypatch.setattr(tactile.readers.limited_process.select, "select", interrupt)
    with pytest.raises(KeyboardInterrupt):
        require_end(path)
    monkeypatch.undo()
    (child,) = children
    with suppress(ProcessLookupError):
        os.kill(child, 0)  # not even as one that waits to be asked after
        os.kill(child, signal.SIGKILL)
        pytest.fail("the process that reads the file is still there")


CHECKING = """
import os, sys
from pathlib import Path
from tactile.readers.hdf5_file import require_end
fork = os.fork
def refuse():
    child = fork()
    if child:
        print(child, flush=True)
    return child
os.fork = refuse
require_end(Path(sys.argv[1]), patience_s=float(sys.argv[2]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_process_that_nobody_ends_has_so_much_processor_time_and_no_more(tmp_path):
    path = with_a_broken_heap(tmp_path / "grasp-1.h5")
    command = [sys.executable, "-c", CHECKING, str(path), "0.5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        child = int(run.stdout.readline())
        run.send_signal(signal.SIGSTOP)
        end = time.monotonic() + 60  # of wall time: 2 s of processor time on a loaded machine
        while is_running(child) and time.monotonic() < end:
            time.sleep(0.05)
        ended = not is_running(child)
        run.kill()
        assert ended
