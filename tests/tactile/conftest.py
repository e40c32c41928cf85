"""An injected grasp that several tests share."""

import numpy as np
import pytest
from injected_grasp import InjectedGrasp, injected_grasp


@pytest.fixture(scope="session")
def injected() -> InjectedGrasp:
    return injected_grasp(np.random.default_rng(11))
