"""What the process that hands out fruit loads."""

import subprocess
import sys

DRAW_OR_MESH = ("open3d", "pyvista", "pytetwild", "matplotlib", "pymeshlab")


def test_who_hands_out_fruit_imports_no_library_that_draws_or_meshes() -> None:
    loaded = f"[name for name in {DRAW_OR_MESH} if name in sys.modules]"
    code = f"import sys, pipeline.run.grading, pipeline.run.fruit_work; print({loaded})"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
