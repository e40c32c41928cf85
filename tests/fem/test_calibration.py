"""The error bar of a modulus is as large as the error that the sensors' noise makes: neither half nor twice.

Truth and estimate are solved on different meshes (drawn_grasps); benchmarks/calibration.py has the other
causes.
"""

import numpy as np
import pytest
from drawn_grasps import Fruit, Off, Sensor, World
from drawn_inference import Estimator
from injected_recording import own_sd_MPa

from fem.estimation.error_budget import ErrorBudget

SIZES = {"edge_mm": 9.0, "refine_edge_mm": 5.0}
SILENT = Sensor(displacement_mm=0.0, force_N=0.0, gel_scale=0.0, force_scale=0.0)
DRAWS = 24


@pytest.mark.slow
def test_noise_of_force_and_displacement_moves_the_modulus_as_stated():
    rng = np.random.default_rng(4)
    world = World.of(Fruit.drawn(rng), np.array([[0.2, 1, 0.1], [1, -0.2, 0.15]]), **SIZES)
    estimator, truths = Estimator.of(world, **SIZES), world.solved(Off())

    def alone(sensor):
        return estimator.alone(truths, E_MPa=0.5, rng=rng, budget=ErrorBudget(), sensor=sensor)

    usual_MPa = [estimate.E_MPa for estimate in alone(SILENT)]
    drawn = [alone(Sensor()) for _ in range(DRAWS)]
    change = [[np.log(each.E_MPa / E) for each, E in zip(row, usual_MPa, strict=True)] for row in drawn]
    stated = [[own_sd_MPa(each) / each.E_MPa for each in row] for row in drawn]
    error = np.sqrt(np.mean(np.square(change)) / np.mean(np.square(stated)))
    assert 0.6 < error < 1.6
