"""Array shapes declared in the room are checked while its tests run."""

import numpy as np
import pytest
from jaxtyping import install_import_hook

with install_import_hook("tactile", "beartype.beartype"):
    import tactile.contact
    import tactile.from_tac3d
    import tactile.marker_places
    import tactile.noise
    import tactile.patch
    import tactile.raw_grasp
    import tactile.recording
    import tactile.registration
    import tactile.sensor_file
    import tactile.stick
    import tactile.tac3d
    import tactile.tracking  # noqa: F401

from planted_grasp import Planted, planted_grasp


@pytest.fixture(scope="session")
def planted() -> Planted:
    return planted_grasp(np.random.default_rng(11))
