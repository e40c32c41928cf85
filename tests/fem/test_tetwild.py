"""The border to pytetwild: what it must not leave behind."""

import subprocess
import sys

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


def test_ctrl_c_still_reaches_python_after_meshing_and_no_file_is_left(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-c", MESH_THEN_INTERRUPT], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "interrupted" in ran.stdout
    assert not list(tmp_path.iterdir())
