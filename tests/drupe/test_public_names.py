"""`import drupe` is fast, changes nothing of the caller's process, and has the names that it promises."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import drupe

PAGE = Path(__file__).parents[2] / "docs" / "python.md"
MODULES = (
    "array_batch", "array_modulus", "batches", "explained", "live_frames", "numbers", "recordings", "refusal",
)  # fmt: skip
AT_MOST_S = 0.3


def said(program: str, *, folder: Path | None = None) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_takes_less_than_a_third_of_a_second_and_no_library():
    """Processor time, which other processes on the machine do not change."""
    program = (
        "import sys, time; start = time.process_time(); import drupe; took = time.process_time() - start; "
        "print(took, 'numpy' in sys.modules)"
    )
    took, loaded = said(program).split()
    assert float(took) < AT_MOST_S
    assert loaded == "False"


def test_the_callers_import_path_and_folder_stay(tmp_path):
    (tmp_path / "mine.py").write_text("E_MPa = 0.5\n")
    root = Path(__file__).parents[2]
    program = (
        f"import os, sys; sys.path.append({str(root)!r}); before = sys.path[:], os.getcwd(); import drupe; "
        "drupe.grade, drupe.read_recording; assert (sys.path, os.getcwd()) == before, sys.path; "
        "import mine; print(mine.E_MPa)"
    )
    assert said(program, folder=tmp_path) == "0.5"


@pytest.mark.parametrize("name", drupe.__all__)
def test_every_public_name_exists_has_a_docstring_and_stands_on_the_page(name):
    value = getattr(drupe, name)
    assert value.__name__ == name
    assert value.__module__.startswith("drupe.")
    assert inspect.getdoc(value)
    assert f"`{name}" in PAGE.read_text(encoding="utf-8")


def test_every_name_that_the_page_uses_is_public():
    used = set(re.findall(r"\bdrupe\.(\w+)", PAGE.read_text(encoding="utf-8")))
    assert used <= {*drupe.__all__, "__all__"}


def test_a_name_that_is_not_public_is_no_attribute():
    with pytest.raises(AttributeError, match="has no attribute 'modulos'"):
        _ = drupe.modulos


def test_no_module_is_left_out():
    folder = Path(drupe.__file__).parent
    assert {path.stem for path in folder.glob("*.py")} == {*MODULES, "__init__"}
