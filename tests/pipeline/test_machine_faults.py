"""Full disks, little memory, killed runs and clocks that are set: the machine's faults, and how they end."""

import errno
import fcntl
import os
import pickle
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from small_batches import python

from pipeline import cli
from pipeline.batch.layout import write_whole
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.scratch import PREFIX, scratch
from pipeline.files.limited_memory import free_memory_MiB
from pipeline.files.whole_file import MARK, NotWritten, put, sweep
from pipeline.problem import BatchRefused
from pipeline.run import grading, runner
from pipeline.run.batch_run import GradeOptions
from pipeline.run.memory import jobs_that_fit


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "No space left on device); free space on that disk, or choose another place."),
        (errno.EDQUOT, "your share of that disk is used up"),
        (errno.EROFS, "Read-only file system); choose another place."),
        (errno.EACCES, "Permission denied); ask for the right to write there"),
        (errno.EFBIG, "ulimit -f"),
    ],
)
def test_a_write_that_fails_names_the_file_the_cause_and_what_to_do(tmp_path, monkeypatch, number, words):
    def fail(_handle):
        raise OSError(number, os.strerror(number))

    path = tmp_path / "ranking.csv"
    put(path, b"old")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(NotWritten) as refused:
        write_whole(path, "new")
    assert str(refused.value).startswith(f"{path}: cannot be written (")
    assert words in str(refused.value)
    assert str(pickle.loads(pickle.dumps(refused.value))) == str(refused.value)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("ranking.csv", b"old")]
    assert ending_of(refused.value) == (Outcome.NOT_WRITTEN, str(refused.value))


def test_a_full_disk_is_the_machines_whichever_library_meets_it():
    hdf5 = OSError("Can't write data (errno = 28, error message = 'No space left on device')")
    for error in (hdf5, OSError(errno.ENOSPC, "No space left on device", "/scratch/x")):
        outcome, said = ending_of(error)
        assert outcome is Outcome.NOT_WRITTEN
        assert "No space left on device); free space" in said
    assert ending_of(MemoryError())[0] is Outcome.OUT_OF_MEMORY
    assert ending_of(FileNotFoundError(errno.ENOENT, "gone"))[0] is Outcome.INTERNAL


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (
            PermissionError(errno.EACCES, "Permission denied", "/batch/fruits"),
            2,
            "/batch/fruits: Permission denied;",
        ),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            2,
            "cannot be written (No space left on device); free",
        ),
        (MemoryError(), 2, "this machine: not enough memory: "),
        (
            ImportError("libopenblas.so: failed to map segment from shared object"),
            2,
            "MiB of address space, and up to 1500 MiB per fruit; close other programs, or raise",
        ),
        (ImportError("No module named 'x'"), 1, "internal error: ImportError"),
        (OSError(errno.EMFILE, "Too many open files", "/batch/x"), 2, "this machine: Too many open files"),
        (
            FileNotFoundError(errno.ENOENT, "No such file", cli.__file__),
            1,
            "internal error: FileNotFoundError",
        ),
        (FileNotFoundError(errno.ENOENT, "No such file", "/tmp/drupe-run-ab/x"), 1, "internal error: "),
    ],
)
def test_only_errors_of_a_users_place_or_machine_are_theirs(monkeypatch, capsys, error, status, said):
    def fail(**_options):
        raise error

    monkeypatch.setattr(cli, "app", fail)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == status
    assert said in capsys.readouterr().err


def while_handling(error, handled):
    """`error` as it is when it happens while `handled` is handled."""
    try:
        try:
            raise handled
        except type(handled):
            raise error  # noqa: B904 - which sets __context__ alone
    except type(error) as came:
        return came


def raised_from(error, cause):
    try:
        raise error from cause
    except type(error) as came:
        return came


@pytest.mark.parametrize(
    ("error", "lacks"),
    [
        (raised_from(ValueError("no mesh"), MemoryError()), True),
        (raised_from(ImportError("numpy"), ImportError("failed to map segment")), True),
        (raised_from(OSError("h5py"), raised_from(ValueError("x"), MemoryError())), True),
        (while_handling(KeyError("E_MPa"), MemoryError()), False),
        (while_handling(TypeError("None"), RuntimeError("std::bad_alloc")), False),
        (raised_from(ValueError("x"), while_handling(KeyError("y"), MemoryError())), False),
    ],
)
def test_a_fault_while_a_lack_of_memory_is_handled_is_a_fault(error, lacks):
    assert (ending_of(error)[0] is Outcome.OUT_OF_MEMORY) is lacks


def test_unfinished_files_of_killed_runs_are_swept_and_others_are_not(tmp_path):
    left, held, theirs = (
        tmp_path / name for name in (f".a.csv{MARK}abcdefgh", f".b.csv{MARK}abcdefgh", ".a.csv.swp")
    )
    for path in (left, held, theirs):
        path.touch()
    (tmp_path / f".c{MARK}abcdefgh").symlink_to(theirs)
    with held.open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        sweep(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {held.name, theirs.name, f".c{MARK}abcdefgh"}
    put(tmp_path / "b.csv", b"")
    assert not held.exists()


def test_scratch_folders_of_killed_runs_are_swept_and_others_are_not(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    killed = (
        "from pipeline.batch.scratch import scratch\nimport os\nwith scratch(): os.kill(os.getpid(), 9)\n"
    )
    assert python(killed, env={**os.environ, "TMPDIR": str(tmp_path)}).returncode == -9
    (left,) = tmp_path.iterdir()
    (tmp_path / "drupe-notes").mkdir()
    (tmp_path / f"{PREFIX}link0000").symlink_to(tmp_path / "drupe-notes")
    with scratch() as running:
        assert not left.exists()
        with scratch() as second:
            assert running.is_dir()
            assert second.is_dir()
    assert {p.name for p in tmp_path.iterdir()} == {"drupe-notes", f"{PREFIX}link0000"}


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def group(place, limit, used, counters, *, version=2):
    """A control group's files."""
    names = ("max", "current") if version == 2 else ("limit_in_bytes", "usage_in_bytes")
    for name, text in zip((*names, "stat"), (f"{limit}\n", f"{used}\n", counters), strict=True):
        write(place / f"memory.{name}", text)


def test_free_memory_is_the_machines_or_less_where_a_group_has_a_limit(tmp_path):
    proc, groups = tmp_path / "proc", tmp_path / "cgroup"
    assert free_memory_MiB(proc, groups) is None
    write(proc / "meminfo", "MemTotal: 9000000 kB\nMemAvailable: 8388608 kB\n")
    assert free_memory_MiB(proc, groups) == 8192
    write(proc / "self" / "cgroup", "0::/job/step\n")
    group(groups / "job", 3 * 2**30, 2 * 2**30, f"anon 1\ninactive_file {2**29}\n")
    group(groups / "job" / "step", "max", 1, "anon 1\n")
    assert free_memory_MiB(proc, groups) == 1536
    write(proc / "self" / "cgroup", "4:cpu:/\n3:memory:/job\n")
    group(groups / "memory", 2**63 - 4096, 1, "total_inactive_file 1\n", version=1)
    group(groups / "memory" / "job", 2 * 2**30, 2**30, f"total_inactive_file {2**28}\n", version=1)
    assert free_memory_MiB(proc, groups) == 1280


def test_so_many_fruit_at_once_as_memory_holds(monkeypatch):
    assert jobs_that_fit(8, per_fruit_MiB=1000, free_MiB=3500) == 3
    assert jobs_that_fit(2, per_fruit_MiB=1000, free_MiB=3500) == 2
    assert jobs_that_fit(8, per_fruit_MiB=1000, free_MiB=10) == 1
    assert jobs_that_fit(8, per_fruit_MiB=1000, free_MiB=None) == 8
    photos = SimpleNamespace(fruit_ply=Path("/nowhere"), without_shape=lambda: False)
    said = []
    console = SimpleNamespace(print=lambda text, **_: said.append(text))
    monkeypatch.setattr(grading, "free_memory_MiB", lambda: 3200.0)
    four = GradeOptions(jobs=4, time_limit_s=600)
    assert grading._processes([photos] * 4, four, console).room() == 2
    assert said[0].startswith("2 fruit at a time instead of 4: 3200 MiB of memory are free")
    monkeypatch.setattr(grading, "free_memory_MiB", lambda: 200.0)
    with pytest.raises(BatchRefused, match=r"has 200 MiB of free memory, but one fruit needs about 1500 MiB"):
        grading._processes([photos], four, console)


def test_a_process_whose_parent_was_gone_before_it_began_ends(monkeypatch):
    ended = []
    monkeypatch.setattr(runner.os, "_exit", ended.append)
    runner._end_with(os.getppid() + 1)
    assert ended == [1]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_stop_that_a_library_takes_for_an_error_of_its_own_is_an_interruption(monkeypatch, capsys, number):
    def importing(**_):
        try:
            os.kill(os.getpid(), number)
            time.sleep(5)
        except KeyboardInterrupt as stop:
            raise ImportError("initialization failed") from stop

    monkeypatch.setattr(cli, "app", importing)
    usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    before = signal.signal(number, usual)  # `nohup` starts tests with SIGHUP ignored
    try:
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert signal.getsignal(number) == usual
    finally:
        signal.signal(number, before)
    assert ended.value.code == 130
    assert capsys.readouterr().err == "drupe: interrupted\n"
