"""What the process that hands out fruit loads, and what a fruit's own process spares."""

import gc
import platform

import pytest
from small_batches import python

from pipeline.safe_start import uncollected

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
