"""A stranger's folder as the current folder: nothing in it is run, imported or read as settings."""

import os
import subprocess
import sys

import pytest
from small_batches import batch_of_balls

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
