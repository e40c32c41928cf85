"""`drupe explain` run in the test's process, on a case whose finder is not there."""

from pathlib import Path
from types import SimpleNamespace

import h5py
from small_batches import times_force

from fem.mismatch.mismatch_case import GradedCase
from fem.mismatch.result import Modulus

DATA = Path(__file__).parent.parent / "data" / "nectarine-grasp"
SETTINGS = """category = "nectarine"
poisson_ratio = 0.45   # assumed
offset_sd_mm = 0.4
size_sd = 0.02
mesh_sd_mm = 0.12
"""
NO_MESH = SimpleNamespace(tets=(), nodes_mm=())
"""Of no use to a finder that is not there; meshing is tested elsewhere."""
GRADED = GradedCase(modulus=Modulus(value=0.5, sd=0.01))


def change(path, edit):
    with h5py.File(path, "r+") as file:
        edit(file)


def stronger(file):
    """Another grasp than the first, by a little."""
    times_force(file, 1.002)
