"""The border to pytetwild: what it must not leave behind."""

import subprocess
import sys
from pathlib import Path

MESH_THEN_INTERRUPT = """
import os, signal, time
import pyvista
from fem.mesh.tetwild import fill

signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the tests' own parent made of it
box = pyvista.Box(bounds=(0, 10, 0, 10, 0, 10)).triangulate()
fill([(box.points, box.regular_faces)], edge_mm=4.0, envelope_mm=0.1)
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(20)
except KeyboardInterrupt:
    print("interrupted")
"""

INTERRUPT_WHILE_MESHING = """
import os, signal, subprocess
import pytetwild
from fem_shapes import ball
from fem.mesh.tetwild import fill

mesher = pytetwild.tetrahedralize

def interrupted_mesher(vertices, *arguments, **named):
    if len(vertices) > 1000:  # the ball's own mesh, which takes seconds
        subprocess.Popen(["sh", "-c", f"sleep 0.5; kill -INT {os.getpid()}"])
    return mesher(vertices, *arguments, **named)

pytetwild.tetrahedralize = interrupted_mesher
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    fill([ball(1500, semi_axes_mm=(30, 30, 30))], edge_mm=5.0, envelope_mm=0.1)
    print("meshed before it came")
except KeyboardInterrupt:
    print("interrupted")
"""
INTERRUPT_WHILE_IMPORTED = """
import os, signal, sys
from importlib.abc import MetaPathFinder

class Interrupts(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.startswith("vtkmodules"):
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
signal.signal(signal.SIGINT, signal.default_int_handler)
from fem_shapes import ball
from fem.mesh.tetwild import simplified
try:
    simplified(*ball(4000, semi_axes_mm=(30, 30, 30)), edge_mm=8.0)
except KeyboardInterrupt:
    print("interrupted", "pyvista" in sys.modules)
"""


def interrupted(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )


def test_ctrl_c_during_the_first_mesh_of_a_process_reaches_python():
    ran = interrupted(INTERRUPT_WHILE_MESHING)
    assert (ran.returncode, ran.stdout) == (0, "interrupted\n"), ran.stderr


def test_ctrl_c_while_vtk_is_imported_comes_afterwards():
    ran = interrupted(INTERRUPT_WHILE_IMPORTED)
    assert (ran.returncode, ran.stdout) == (0, "interrupted True\n"), ran.stderr


def test_ctrl_c_still_reaches_python_after_meshing_and_no_file_is_left(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-c", MESH_THEN_INTERRUPT], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stdout) == (0, "interrupted\n"), ran.stderr
    assert not list(tmp_path.iterdir())
