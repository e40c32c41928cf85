"""The machine: full disks, killed runs, interruptions, a stranger's current folder, missing libraries."""

import errno
import fcntl
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest
from small_batches import batch_of_balls, python

from pipeline import cli
from pipeline.batch.layout import write_whole
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.scratch import PREFIX, scratch
from pipeline.exit_status import INTERRUPTED
from pipeline.files.limited_memory import free_memory_MiB
from pipeline.files.whole_file import MARK, NotWritten, put, sweep
from pipeline.problem import BatchRefused
from pipeline.run import grading, runner
from pipeline.run.batch_run import GradeOptions
from pipeline.run.memory import jobs_that_fit
from pipeline.system_libraries import missing_libraries


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


ENTRY = "from pipeline.cli import main\nif __name__ == '__main__':\n    main()\n"
LOG = """
import os, sys
def audited(event, arguments):
    if event == "import":
        handle = os.open(os.environ["IMPORTS"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.write(handle, (arguments[0].split(".")[0] + "\\n").encode())
        os.close(handle)
sys.addaudithook(audited)
"""
MODULE = "import os\nopen(os.environ['MARKS'], 'a').write({name!r} + '\\n')\nraise ImportError({name!r})\n"
LIBRARIES = ("libEGL.so.1", "libtbb.so.12", "libtbbmalloc.so.2", "libm.so.6", "libstdc++.so.6", "libz.so.1")
RC = "text.usetex: True\nbackend: module://foreign_backend\n"


def drupe(folder, *arguments, start=(), **environment):
    """Runs the installed command's own lines, a script that lies elsewhere, in the folder `folder`."""
    left_out = {"PYTHONSAFEPATH", "LD_LIBRARY_PATH"}  # OpenCV, imported by a test, sets the latter
    clean = {name: value for name, value in os.environ.items() if name not in left_out}
    return subprocess.run(
        [sys.executable, *start, *arguments],
        cwd=folder,
        env={**clean, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture
def entry(tmp_path):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "drupe").write_text(ENTRY)
    return tmp_path / "bin" / "drupe"


@pytest.mark.slow
def test_no_module_library_or_setting_of_the_current_folder_is_used(tmp_path, entry):
    """A ball that nobody grasped; every name that the command and a fruit's process ask for is put there."""
    (tmp_path / "hooks").mkdir()
    (tmp_path / "hooks" / "sitecustomize.py").write_text(LOG)
    honest, stranger, imports, marks = (tmp_path / n for n in ("honest", "stranger", "imports", "marks"))
    batch_of_balls(honest, "ball")
    asked = drupe(tmp_path, entry, "grade", honest, PYTHONPATH=str(tmp_path / "hooks"), IMPORTS=str(imports))
    assert asked.returncode == 3, asked.stderr
    assert "no-grasp" in asked.stderr
    names = {name for name in imports.read_text().split("\n") if name.isidentifier()}
    assert {"pickle", "numpy", "matplotlib", "pebble", "scipy", "pipeline"} <= names

    batch_of_balls(stranger, "ball")
    for name in names | {"sitecustomize", "usercustomize", "foreign_backend"}:
        (stranger / f"{name}.py").write_text(MODULE.format(name=name))
    (stranger / "evil.pth").write_text("import pickle\n")
    (stranger / "matplotlibrc").write_text(RC)
    for name in LIBRARIES:
        (stranger / name).write_bytes(b"no library")
    marked = {"MARKS": str(marks)}
    ran = drupe(stranger, entry, "grade", ".", **marked)
    assert not marks.exists(), marks.read_text()
    assert ran.returncode == 3, ran.stderr
    assert "no-grasp" in ran.stderr
    ran = drupe(stranger, entry, "explain", ".", "--fruit", "ball", **marked)
    assert "holds no recording" in ran.stderr


def test_a_current_folder_that_pythonpath_names_is_the_users_own_word(tmp_path):
    shown = "import sys, pipeline.safe_start; print(*sys.path, sep='|')"
    (tmp_path / "shown.py").write_text(shown)
    (tmp_path / "here").mkdir()
    here = tmp_path / "here"
    for said in (str(here), "."):
        ran = drupe(here, tmp_path / "shown.py", PYTHONPATH=said)
        assert str(here) in ran.stdout.strip().split("|"), ran.stderr


def test_started_as_a_module_no_library_comes_from_the_current_folder(tmp_path):
    for name in ("typer", "rich", "numpy"):
        (tmp_path / f"{name}.py").write_text(MODULE.format(name=name))
    ran = drupe(tmp_path, "--version", start=("-m", "pipeline"), MARKS=str(tmp_path / "marks"))
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith("drupe ")
    assert not (tmp_path / "marks").exists()


ABSENT = (
    "import sys; sys.modules.update(dict.fromkeys(['pycolmap', 'pymetis', 'pymeshlab', 'fcntl'][:{count}]))\n"
)


def ran(code: str, *, absent: int = 3) -> subprocess.CompletedProcess[str]:
    """A Python of its own, in which imports of the first `absent` packages fail."""
    return python(ABSENT.format(count=absent) + code)


def test_doctor_grades_the_known_ball_and_names_what_is_absent():
    done = ran("sys.argv = ['drupe', 'doctor']; from pipeline.start import main; main()")
    assert done.returncode == 0, done.stderr
    assert "optional library pycolmap does not load" in done.stdout
    assert "optional library pymetis does not load" in done.stdout
    assert done.stdout.endswith("all well\n")


def test_photos_of_the_mat_are_placed_without_pycolmap():
    done = ran("import recon.cameras.mat_poses; assert 'recon.cameras.motion' not in sys.modules")
    assert done.returncode == 0, done.stderr


def test_windows_is_refused_in_a_sentence():
    code = "sys.platform = 'win32'; import pipeline.start"
    done = ran(code, absent=4)
    assert done.returncode == 2
    assert done.stderr.startswith("drupe: this machine: Windows is not supported")
    assert done.stderr.count("\n") == 1


def test_nothing_is_said_where_all_libraries_are_there():
    assert missing_libraries({"libc.so.6": ("libc6", "everything")}) == []


def test_a_missing_library_is_named_with_its_package():
    (sentence,) = missing_libraries({"libnowhere.so.9": ("libnowhere9", "Open3D")})
    assert "libnowhere.so.9 is missing" in sentence
    assert "apt-get install -y --no-install-recommends libnowhere9" in sentence


LOADING = """
import os, signal
from pipeline.interruption import ended_like_ctrl_c, held_back
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
try:
    with ended_like_ctrl_c(), held_back():
        os.kill(os.getpid(), signal.{name})
        print("loaded", flush=True)
    print("works", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
WORKING = """
import os, signal
from pipeline.interruption import ended_like_ctrl_c
signal.signal(signal.SIGHUP, signal.SIG_DFL)
with ended_like_ctrl_c() as came:
    for _ in range(2):
        try:
            os.kill(os.getpid(), signal.{name})
            print("goes on", flush=True)
        except KeyboardInterrupt:
            print("interrupted", came == [signal.{name}], flush=True)
"""


def _ended(script: str) -> tuple[int, str, str]:
    done = python(script)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP", "SIGTERM"])
def test_an_interruption_while_libraries_load_waits_until_they_are_loaded(name):
    assert _ended(LOADING.format(name=name)) == (0, "loaded\ninterrupted\n", "")


@pytest.mark.parametrize(("name", "number"), [("SIGTERM", 15), ("SIGHUP", 1)])
def test_a_second_signal_ends_the_work_at_once(name, number):
    assert _ended(WORKING.format(name=name)) == (-number, "interrupted True\n", "")


WHEN = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
sys.argv = ["drupe", "new", "nowhere"]
import pipeline.start
pipeline.start.main()
"""


@pytest.mark.parametrize("module", ["gc", "pipeline.lack_of_memory", "typer", "pipeline.cli", "rich"])
def test_an_early_ctrl_c_ends_the_command_without_a_traceback(module):
    assert _ended(WHEN.format(module=module)) == (INTERRUPTED, "", "drupe: interrupted\n")


def test_a_command_at_work_says_that_it_was_interrupted(drupe):
    with mock.patch("pipeline.history.lot_quality.sampling_plan", side_effect=KeyboardInterrupt):
        ran = drupe("plan")
    assert (ran.status, ran.out, ran.err) == (INTERRUPTED, "", "drupe: interrupted\n")


def test_an_ignored_ctrl_c_stays_ignored():
    script = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
import pipeline.start
print(signal.getsignal(signal.SIGINT) == signal.SIG_IGN)
"""
    assert _ended(script) == (0, "True\n", "")
