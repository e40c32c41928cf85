"""A planted grasp that several tests share."""

import numpy as np
import pytest
from planted_grasp import Planted, planted_grasp


@pytest.fixture(scope="session")
def planted() -> Planted:
    return planted_grasp(np.random.default_rng(11))
