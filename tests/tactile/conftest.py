"""An injected grasp, and one by another solver, that several tests share."""

from pathlib import Path

import numpy as np
import pytest
from injected_grasp import InjectedGrasp, injected_grasp

from recon.surface.mesh_file import Mesh, read_mesh
from tactile.contact import Contact, find_contact
from tactile.readers.recording import Recording, read_recording

DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"


@pytest.fixture(scope="session")
def injected() -> InjectedGrasp:
    return injected_grasp(np.random.default_rng(11))


@pytest.fixture(scope="session")
def contact(injected: InjectedGrasp) -> Contact:
    return find_contact(injected.recording, source="injected.h5")


@pytest.fixture(scope="session")
def nectarine_grasp() -> tuple[Recording, Mesh]:
    """tests/data/nectarine-grasp: a recording by another solver, with noise, and the scanned mesh."""
    return read_recording(DATA / "grasp.h5"), read_mesh(DATA / "fruit.ply")
