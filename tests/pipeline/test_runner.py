"""One fruit per process, with its progress: a crash, a hang or an exception costs that fruit only."""

import gc
import logging
import multiprocessing
import os
import pickle
import platform
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import psutil
import pytest
from small_batches import python, wait_until

from pipeline.batch.outcome import Outcome, ending_of
from pipeline.run.runner import MOST_BYTES, LinesOf, LocalPool
from pipeline.run.scheduling import Died, Finished, Noted, Progressed, TimedOut, run_on
from pipeline.safe_start import uncollected


def work(task, report):
    report("working")
    if task == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if task == "hang":
        time.sleep(600)
    if task == "raise":
        raise RuntimeError("broken")
    return task


def endings(tasks, **options):
    events = list(run_on(LocalPool(**options), work, [(t, t) for t in tasks]))
    return events, {e.fruit_id: e for e in events if not isinstance(e, Progressed)}


def test_each_fruit_ends_in_its_own_way():
    events, ended = endings(["fine", "crash", "hang", "raise", "also fine"], jobs=2, time_limit_s=8)
    assert isinstance(ended["fine"], Finished)
    assert isinstance(ended["also fine"], Finished)
    assert isinstance(ended["crash"], Died)
    assert ended["crash"].exit_code == -signal.SIGSEGV
    assert isinstance(ended["hang"], TimedOut)
    assert isinstance(ended["raise"].result, RuntimeError)
    assert Progressed("fine", "working") in events


@pytest.mark.parametrize(
    "after_s", [0.0, 0.1, *(pytest.param(s, marks=pytest.mark.proof) for s in (0.05, 0.15, 0.2))]
)
def test_a_process_killed_before_it_says_anything_costs_its_fruit_and_holds_up_nobody(after_s):
    """Whether it was still starting, importing, or already had its task."""

    def kill_one():
        wait_until(multiprocessing.active_children)
        time.sleep(after_s)
        for child in multiprocessing.active_children()[:1]:
            os.kill(child.pid, signal.SIGKILL)

    killer = threading.Thread(target=kill_one)
    killer.start()
    began = time.monotonic()
    _, ended = endings(["a", "b", "c", "d"], jobs=1, time_limit_s=300)
    killer.join()
    assert time.monotonic() - began < 120
    assert sorted(ended) == ["a", "b", "c", "d"]
    died = [event for event in ended.values() if isinstance(event, Died)]
    assert len(died) <= 1
    assert all(event.exit_code in (-signal.SIGKILL, None) for event in died)
    if after_s == 0.0:
        assert died


def surroundings(task, report):
    report(f"photos: {task}")
    return os.getpid(), os.environ["OPENBLAS_NUM_THREADS"], sys.path, str(Path.cwd()), os.environ["TMPDIR"]


def test_every_fruit_has_a_process_of_its_own_in_an_empty_folder_that_is_gone_afterwards():
    """Whatever its files are called: names need not be UTF-8."""
    tasks = [("a", os.fsdecode(b"gr\xffasp")), ("b", "Grün"), ("c", "c")]
    events = list(run_on(LocalPool(jobs=1, time_limit_s=60), surroundings, tasks))
    stages = [event.stage for event in events if isinstance(event, Progressed)]
    assert stages == ["photos: gr\\udcffasp", "photos: Grün", "photos: c"]
    results = [event.result for event in events if isinstance(event, Finished)]
    processes, threads, paths, folders, temporary = zip(*results, strict=True)
    assert len(set(processes)) == 3
    assert set(threads) == {"1"}
    assert all("" not in path for path in paths)
    assert str(Path.cwd()) not in folders
    assert os.environ.get("TMPDIR") not in temporary
    assert not any(Path(place).exists() for place in (*folders, *temporary))


PARENT = """
import sys
sys.path.insert(0, {tests!r})
from test_runner import {work}
from pipeline.run.runner import LocalPool
from pipeline.run.scheduling import run_on
if __name__ == "__main__":
    for event in run_on(LocalPool(jobs=1, time_limit_s=600), {work}, [("a", {mark!r})]):
        pass
"""


def sleeper(mark, report):
    Path(mark).write_text(str(os.getpid()))
    time.sleep(600)


def idle(seconds, report):
    report("idle")
    time.sleep(seconds)


def test_a_clock_set_forward_costs_no_fruit_and_one_set_back_lets_none_hang(monkeypatch):
    """The time of day is set while the fruit is worked on."""
    real = time.time
    for seconds, step_s, limit_s, kind in ((2, 1e6, 60, Finished), (600, -1e6, 4, TimedOut)):
        for event in run_on(LocalPool(jobs=1, time_limit_s=limit_s), idle, [("a", seconds)]):
            if isinstance(event, Progressed):
                monkeypatch.setattr(time, "time", lambda step_s=step_s: real() + step_s)
            else:
                assert type(event) is kind


def deaf(mark, report):
    """Native code that never lets another thread of Python's run."""
    import ctypes

    Path(mark).write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(600)


@pytest.mark.parametrize(
    "work",
    [
        "sleeper",
        pytest.param(
            "deaf",
            marks=pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends native code too"),
        ),
    ],
)
def test_a_killed_run_leaves_no_process_behind(tmp_path, work):
    script, mark = tmp_path / "parent.py", tmp_path / "mark"
    script.write_text(PARENT.format(work=work, tests=str(Path(__file__).parent), mark=str(mark)))
    with subprocess.Popen([sys.executable, str(script)]) as parent:
        wait_until(lambda: mark.exists() and mark.read_text())
        parent.kill()
    worker = int(mark.read_text())
    try:
        wait_until(lambda: not psutil.pid_exists(worker) or psutil.Process(worker).status() == "zombie", 10)
    finally:
        if psutil.pid_exists(worker):
            os.kill(worker, signal.SIGKILL)


def like_metis(mark, report):
    """The signal to end is taken for a failure while unknowns are ordered, and the work goes on."""

    def go_on(*_):
        Path(mark).write_text("a false record")

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, go_on)
    report("ordering")
    for _ in range(600):
        time.sleep(0.1)


@pytest.mark.parametrize("out_of_time", [True, False], ids=["out of time", "left early"])
def test_work_that_was_stopped_writes_nothing_more(tmp_path, out_of_time):
    mark, pool = tmp_path / "mark", LocalPool(jobs=1, time_limit_s=600)
    events = run_on(pool, like_metis, [("a", str(mark))])
    assert next(events) == Progressed("a", "ordering")
    if out_of_time:
        pool._time_limit_s = 0.0
        assert list(events) == [TimedOut("a")]
    events.close()
    wait_until(lambda: not multiprocessing.active_children())  # a killed process is gone a moment later
    assert not mark.exists()


def soon_done(mark, report):
    Path(mark).write_text("begun")
    report("working")
    time.sleep(2)
    Path(mark).write_text("done")


def test_ctrl_c_is_for_the_run_and_not_for_the_work_on_a_fruit(tmp_path):
    script, mark = tmp_path / "parent.py", tmp_path / "mark"
    parent = PARENT.format(work="soon_done", tests=str(Path(__file__).parent), mark=str(mark))
    script.write_text(f"import signal\nsignal.signal(signal.SIGINT, lambda *_: None)\n{parent}")
    with subprocess.Popen(
        [sys.executable, str(script)], start_new_session=True, stderr=subprocess.PIPE, text=True
    ) as run:
        wait_until(lambda: psutil.Process(run.pid).children())
        for _ in range(20):  # the process of the fruit is still importing when they begin
            os.killpg(run.pid, signal.SIGINT)
            time.sleep(0.05)
        _, said = run.communicate(timeout=60)
    assert said == ""
    assert mark.read_text() == "done"


def without_memory(how, report):
    report("working")
    if how == "too much":
        held = bytearray(b"1") * (600 * 2**20)
        time.sleep(60)
        return len(held)
    if how == "C++":
        os.write(
            2, b"terminate called after throwing an instance of 'std::bad_alloc'\n  what():  std::bad_alloc\n"
        )
        os.abort()
    if how == "OpenBLAS":
        os.write(2, b"OpenBLAS error: Memory allocation still failed after 10 retries, giving up.\n")
        os._exit(1)
    if how == "long before":
        os.write(
            2, b"vtk: out of memory, a smaller buffer is used\n" + b"".join(b"%d\n" % k for k in range(5))
        )
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "loader":
        raise ImportError("libx.so: failed to map segment from shared object")
    return "done"


def test_a_lack_of_memory_ends_the_fruit_as_that_in_whatever_way_it_shows():
    pool = LocalPool(jobs=2, time_limit_s=120, most_MiB=300.0)
    tasks = [(how, how) for how in ("too much", "C++", "OpenBLAS", "loader", "enough", "long before")]
    events = list(run_on(pool, without_memory, tasks))
    ended = {e.fruit_id: e.result for e in events if isinstance(e, Finished)}
    assert Died("long before", -signal.SIGSEGV) in events  # a lack long before is not a crash's cause
    assert ended.pop("enough") == "done"
    assert {how: ending_of(error)[0] for how, error in ended.items()} == dict.fromkeys(
        ("too much", "C++", "OpenBLAS", "loader"), Outcome.OUT_OF_MEMORY
    )
    assert "more than the 300 MiB limit per fruit" in ending_of(ended["too much"])[1]
    assert "Memory allocation still failed" in ending_of(ended["OpenBLAS"])[1]


def talkative(how, report):
    report("mesh")
    if how == "logs":
        try:
            raise KeyError("texture")
        except KeyError:
            logging.getLogger("trimesh").exception("failed to load")
    if how == "warns":
        warnings.warn("deprecated", UserWarning, stacklevel=1)
    if how == "native":
        os.write(1, b"[Open3D WARNING] no normals\n")
        os.write(2, b"ERROR: In vtkPolyData.cxx, line 7\n")
    return "done"


def test_what_libraries_log_warn_and_print_is_told_of_their_fruit_and_not_shown(capfd):
    tasks = [(how, how) for how in ("logs", "warns", "native")]
    events = list(run_on(LocalPool(jobs=3, time_limit_s=60), talkative, tasks))
    assert capfd.readouterr() == ("", "")
    lines = {
        how: [e.line for e in events if isinstance(e, Noted) and e.fruit_id == how]
        for how in ("logs", "warns", "native")
    }
    assert lines["logs"][0] == "trimesh: failed to load"
    assert "Traceback (most recent call last):" in lines["logs"]
    assert lines["warns"][0].startswith("py.warnings: ")
    assert "UserWarning: deprecated" in lines["warns"][0]
    assert lines["native"] == ["[Open3D WARNING] no normals", "ERROR: In vtkPolyData.cxx, line 7"]
    assert sorted(e.result for e in events if isinstance(e, Finished)) == ["done"] * 3


def endless(size, report):
    for _ in range(size // 2**20):
        os.write(1, b"%s\n" % (b"x" * (2**20 - 1)))
        time.sleep(0.02)
    os.write(1, b"the end\n")
    return "done"


def test_what_libraries_write_without_end_is_cut(tmp_path):
    with LocalPool(jobs=1, time_limit_s=60) as pool:
        pool.begin("a", pickle.dumps((endless, 64 * 2**20)))
        events, held = [], 0
        while not any(isinstance(event, Finished) for event in events):
            events += pool.happened()
            held = max(
                [
                    held,
                    *(
                        fruit_process.output.stat().st_size
                        for fruit_process in pool._pending.values()
                        if fruit_process.output.exists()
                    ),
                ]
            )
    lines = [event.line for event in events if isinstance(event, Noted)]
    assert sum(map(len, lines)) < 2**20 + 100
    assert lines[-1] == "libraries wrote more than 1 MiB; drupe left out the rest"
    assert held < 32 * 2**20


DRAW_OR_MESH = ("open3d", "pyvista", "pytetwild", "matplotlib", "pymeshlab")
FREED = """
import os
from pathlib import Path
from pipeline.files.limited_memory import return_freed_memory

def resident_MiB():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

blocks = [bytes(60_000) for _ in range(3000)]
last = blocks.pop()
blocks.clear()
before = resident_MiB()
return_freed_memory()
print(before - resident_MiB())
"""
"""Blocks that are taken from the heap and lie below one in use; prints what goes back (MiB) of about 170."""


def test_who_hands_out_fruit_imports_no_library_that_draws_or_meshes() -> None:
    loaded = f"[name for name in {DRAW_OR_MESH} if sys.modules.get(name)]"
    assert python(f"import sys, pipeline.run.grading; print({loaded})").stdout == "[]\n"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps what is freed")
def test_memory_that_a_stage_has_freed_goes_back_to_the_system() -> None:
    assert float(python(FREED).stdout) > 100


def test_nothing_is_looked_through_for_garbage_while_libraries_are_imported() -> None:
    with uncollected():
        assert not gc.isenabled()
        with uncollected():
            pass
        assert not gc.isenabled()
    assert gc.isenabled()


@pytest.fixture
def added(tmp_path):
    """A function that adds bytes to the file, and the reader of its lines."""
    lines = LinesOf(tmp_path / "log")

    def add(data):
        with lines.path.open("ab") as file:
            file.write(data)

    return add, lines


def test_whole_lines_are_read_once(added):
    add, lines = added
    assert lines.new() == []
    add(b"a\nb")
    assert lines.new() == ["a"]
    assert lines.new() == []
    add(b"c\r\n\xff\rd\n")
    assert lines.new() == ["bc", "\ufffd", "d"]


def test_what_was_read_is_not_read_again(added, monkeypatch):
    """After the first call the file's beginning may be anything."""
    add, lines = added
    add(b"first\n")
    assert lines.new() == ["first"]
    with lines.path.open("r+b") as file:
        file.write(b"\n\n\n\n\n\n")
    add(b"second\n")
    assert lines.new() == ["second"]


def test_of_much_the_last_is_read_and_the_file_is_emptied(added):
    add, lines = added
    add(b"x" * 3 * MOST_BYTES + b"\nlast\n")
    assert lines.new()[-1] == "last"
    assert lines.path.stat().st_size == 0
    add(b"next\n")
    assert lines.new() == ["next"]


def test_a_line_without_end_does_not_stay(added):
    add, lines = added
    for _ in range(8):
        add(b"x" * MOST_BYTES)
        assert lines.new() == []
        assert lines.path.stat().st_size <= 2 * MOST_BYTES
    add(b"\nlast\n")
    assert lines.new()[-1] == "last"
