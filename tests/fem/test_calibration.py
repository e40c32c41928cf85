"""Error bars of the modulus are as large as its errors: neither half of them nor twice.

Truth and estimate are solved on different meshes, and what is off is moved by other fields than those whose
sensitivities make the error bars (drawn_grasps).
"""

from dataclasses import replace

import numpy as np
import pytest
from drawn_grasps import Fruit, Off, Sensor, World
from drawn_inference import Estimator, drawn_off

from fem.estimation.error_budget import REGISTRATION, TACTILE, ErrorBudget
from fem.estimation.joint_inference import joint_modulus

SIZES = {"edge_mm": 7.0, "refine_edge_mm": 5.0}
NOTHING = ErrorBudget(
    force_scale_sd=1e-6, pit_offset_sd_mm=0.0, pit_size_sd=0.0, surface_sd_mm=0.0, pose_sd_mm=0.0
)
SILENT = Sensor(displacement_mm=0.0, force_N=0.0, gel_scale=0.0, force_scale=0.0)
E_MPA = 0.5


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    rng = np.random.default_rng(4)
    world = World.of(Fruit.drawn(rng), np.array([[0.2, 1, 0.1], [1, -0.2, 0.15]]), **SIZES)
    return Estimator.of(world, **SIZES)


def errors(estimator: Estimator, budget: ErrorBudget, part: str, *, draws: int, sensor: Sensor = SILENT):
    """Root mean square of ln E's change over draws of one cause, and of the error bar's part."""
    rng = np.random.default_rng(5)
    options = {"E_MPa": E_MPA, "rng": rng, "budget": ErrorBudget()}
    world = estimator.world
    usual = [estimate.E_MPa for estimate in estimator.alone(world.solved(Off()), sensor=SILENT, **options)]
    change, stated = [], []
    for _ in range(draws):
        truths = world.solved(drawn_off(rng, budget))
        for estimate, E_MPa in zip(estimator.alone(truths, sensor=sensor, **options), usual, strict=True):
            known = joint_modulus([estimate.evidence], budget=budget, infer_pit=False)
            change.append(np.log(estimate.E_MPa / E_MPa))
            stated.append(known.parts_sd_MPa[part] / known.E_MPa)
    return float(np.sqrt(np.mean(np.square(change)))), float(np.sqrt(np.mean(np.square(stated))))


@pytest.mark.proof
def test_noise_of_force_and_displacement_moves_the_modulus_as_stated(estimator):
    budget = replace(NOTHING, force_scale_sd=0.01)
    error, stated = errors(estimator, budget, TACTILE, draws=12, sensor=Sensor())
    assert 0.6 < error / stated < 1.6


@pytest.mark.proof
def test_a_pit_of_another_size_moves_the_modulus_as_stated(estimator):
    error, stated = errors(estimator, replace(NOTHING, pit_size_sd=0.03), "pit size", draws=4)
    assert 0.55 < error / stated < 1.8


@pytest.mark.proof
def test_another_skin_moves_the_modulus_as_stated(estimator):
    error, stated = errors(estimator, replace(NOTHING, surface_sd_mm=0.1), REGISTRATION, draws=4)
    assert 0.5 < error / stated < 2
