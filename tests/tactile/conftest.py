"""Array shapes declared in the room are checked while its tests run."""

import numpy as np
import pytest
from jaxtyping import install_import_hook

with install_import_hook("tactile", "beartype.beartype"):
    pass

from planted_grasp import Planted, planted_grasp


@pytest.fixture(scope="session")
def planted() -> Planted:
    return planted_grasp(np.random.default_rng(11))
