"""Stiffening, plastic set and damage as effects: their searches against exact solutions, their signatures."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from coarse_fruit import NU, fruit_mesh
from pinched_case_model import as_case, long_pinch, model_of

from fem.materials.strain_path import linear_stress
from fem.mismatch.effects import damage, plastic_set, stiffening
from fem.mismatch.model import stress_history
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import plain_model
from fem.mismatch.model.stress_history import path_frames, path_state
from fem.mismatch.model.warm_start import WarmStarts
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.flesh_pieces import FleshPieces
from fem.solid.initial_stress import AddedStress
from fem.solid.strain_field import FleshStrain


def test_forces_of_the_linear_stress_are_those_of_the_stiffness_matrix():
    model = model_of()
    solid = model.grasps[0].solid
    moved = np.random.default_rng(4).normal(size=(2, *fruit_mesh().nodes_mm.shape))
    pieces = FleshPieces.of(FleshStrain.of(fruit_mesh()))
    forces = pieces.forces(moved, lambda gradient: linear_stress(gradient, poisson_ratio=NU))
    expected = (solid.stiffness @ moved.reshape(2, -1).T).T.reshape(moved.shape)
    off = np.linalg.norm(forces - expected) / np.linalg.norm(expected)
    assert off < 0.02  # curved elements: four points here, fourteen in the stiffness


@pytest.mark.parametrize("stiffness", [0.5, 3.0])
@pytest.mark.parametrize("together", [True, False])
def test_rounds_find_flesh_that_is_stiffer_or_softer_as_a_whole(stiffness, together):
    model = model_of()
    state = path_state(model, frames=4, remembers=True)
    solid = model.grasps[0].solid

    def excess_force(moved: np.ndarray) -> np.ndarray:
        forces = (solid.stiffness @ moved.reshape(len(moved), -1).T).T.reshape(moved.shape)
        return (stiffness - 1) * forces

    skin = fruit_mesh().outer_nodes
    problem = AddedStress(
        linear=state.linear,
        added_force=excess_force,
        response=state.response,
        compliance=model.compliance,
        stiffer=np.full(len(state.linear), stiffness),
        skin=skin,
    )
    more = problem.beyond_linear(start=None, together=together, tolerance_mm=6e-4, rounds=40)
    off = model.compliance * (more - (1 / stiffness - 1) * state.linear)[:, skin]
    assert np.abs(off).max() < 1e-3


def test_a_few_frames_tell_all_others_what_a_smooth_law_of_the_load_does():
    load = np.concatenate([np.linspace(0, 1, 12), np.linspace(1, 0, 12)])
    shares = np.column_stack([load, 0.1 * load**2])
    patterns = np.zeros((2, 1, 3))
    patterns[[0, 1], 0, [0, 1]] = 1.0
    recording = SimpleNamespace(shares=shares, patterns=patterns, response=patterns)
    (frames,) = path_frames([recording], 6, remembers=False)
    assert len(frames.chosen) == 6
    law = load**2 + 0.3 * load**3
    np.testing.assert_allclose(frames.mix @ law[frames.chosen], law, atol=1e-5)
    law = load**2.5
    np.testing.assert_allclose(frames.mix @ law[frames.chosen], law, atol=5e-3)


def test_a_law_that_remembers_is_told_apart_on_the_way_up_and_down():
    load = np.concatenate([np.linspace(0, 1, 12), np.linspace(1, 0, 12)])
    recording = SimpleNamespace(shares=load[:, None])
    (frames,) = path_frames([recording], 10, remembers=True)
    law = load * np.maximum.accumulate(load)
    np.testing.assert_allclose(frames.mix @ law[frames.chosen], law, atol=5e-3)


@pytest.mark.parametrize(
    ("module", "parameters"),
    [(damage, {"dmax": 0.3, "W0_over_E": 0.002}), (plastic_set, {"yield_over_E": 0.06})],
)
def test_softer_flesh_answers_alike_where_its_law_sees_the_same(monkeypatch, module, parameters):
    """By EffectParameter.strain_power, which spares solving again for another E."""
    monkeypatch.setattr(stress_history, "CLOSE_MM", 1e-7)
    firm = model_of()
    soft = replace(firm, compliance=1.5 * firm.compliance)
    plain = firm.grasps[0].tracks.unit_displacement
    design_effect = {
        spec.name: parameters[spec.name] * 1.5**spec.strain_power for spec in module.EFFECT.spec.searched
    }
    more = module.EFFECT.respond(firm, parameters, ONE_WAY).unit[0] - plain
    change = module.EFFECT.respond(soft, design_effect, ONE_WAY).unit[0] - plain
    other = module.EFFECT.respond(soft, parameters, ONE_WAY).unit[0] - plain
    size = np.linalg.norm(more)
    assert np.linalg.norm(change - more) < 2e-3 * size
    assert np.linalg.norm(other - more) > 0.1 * size


def test_a_search_that_starts_from_a_solution_ends_at_the_same_one():
    plain = model_of()
    search = replace(plain, warm_starts=WarmStarts())
    parameters = {"dmax": 0.3, "W0_over_E": 0.002}
    damage.EFFECT.respond(search, {"dmax": 0.35, "W0_over_E": 0.002}, ONE_WAY)
    afresh, warm = (damage.EFFECT.respond(at, parameters, ONE_WAY).unit[0] for at in (plain, search))
    assert plain.compliance * np.abs(warm - afresh).max() < 2 * stress_history.CLOSE_MM


def difference(module: object, model: CaseModel, parameters: dict[str, float], base: dict[str, float]):
    effect = module.EFFECT
    response = effect.respond(model, parameters, ONE_WAY).unit[0]
    return model.compliance * (response - effect.respond(model, base, ONE_WAY).unit[0])


def cosine_and_ratio(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    return float((a * b).sum() / np.linalg.norm(a) / np.linalg.norm(b)), float(
        np.linalg.norm(a) / np.linalg.norm(b)
    )


def test_damage_signature_is_the_start_of_its_response():
    model = model_of()
    signature = damage.EFFECT.signatures(model)[1]
    W0 = damage.EFFECT.start(model, signature, np.array([0.1]))["W0_over_E"]
    moved = difference(damage, model, {"dmax": 0.06, "W0_over_E": W0}, {"dmax": 0.02, "W0_over_E": W0})
    cosine, ratio = cosine_and_ratio(moved, 0.04 * signature.columns[0].fields[0].markers)
    assert cosine > 0.999
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_stiffening_signature_is_the_start_of_its_response_where_strains_are_small(monkeypatch):
    monkeypatch.setattr(stress_history, "CLOSE_MM", 2e-6)
    model = replace(model_of(), compliance=0.8)
    markers = stiffening.EFFECT.signatures(model)[0].columns[0].fields[0].markers
    moved = difference(stiffening, model, {"b": 4.0}, {"b": 0.5})
    cosine, ratio = cosine_and_ratio(moved, 3.5 * markers)
    assert cosine > 0.99
    assert ratio == pytest.approx(1.0, abs=0.1)


def plastic_against_signature(relative: float) -> tuple[float, float]:
    effect, model = replace(plastic_set.EFFECT, relative=(relative,)), model_of()
    (signature,) = effect.signatures(model)
    unit = effect.respond(model, effect.start(model, signature, np.ones(1)), ONE_WAY).unit[0]
    moved = model.compliance * (unit - model.grasps[0].tracks.unit_displacement)
    return cosine_and_ratio(moved, signature.columns[0].fields[0].markers)


def test_plastic_signature_is_the_start_of_its_response_where_flesh_hardly_yields(monkeypatch):
    model = model_of()
    stress, level = plastic_set.EFFECT.largest_seen(model)
    monkeypatch.setattr(stress_history, "CLOSE_MM", 1e-8)
    cosine, ratio = plastic_against_signature(0.99 * stress.max() / level)
    assert cosine > 0.999
    stays = 2 * (4 - 5 * model.poisson_ratio) / (15 * (1 - model.poisson_ratio))
    assert 0.99 < ratio < 1 / (1 - stays)  # Eshelby 1957: the share of a sphere's shear that stays in it


@cache
def twice_pinched() -> CaseModel:
    case = as_case(long_pinch())
    twice = (case.grasps[0], replace(case.grasps[0], name="grasp-2"))
    return CaseModel(base=plain_model(replace(case, grasps=twice)), compliance=4.0)


@pytest.mark.parametrize(
    ("module", "parameters"),
    [(damage, {"dmax": 0.4, "W0_over_E": 0.002}), (plastic_set, {"yield_over_E": 0.03})],
)
def test_the_second_recording_finds_the_flesh_as_the_first_one_left_it(module, parameters):
    model = twice_pinched()
    first, second = module.EFFECT.respond(model, parameters, ONE_WAY).unit
    plain = model.grasps[0].tracks.unit_displacement
    size = np.linalg.norm(first - plain)
    assert size > 0
    # what the first left is there before the second begins, and its peak adds nothing new
    assert np.linalg.norm((second - first)[0]) > 0.02 * size
    peak = int(model.grasps[0].load.argmax())
    assert np.linalg.norm((second - first)[peak:]) < 0.05 * size
