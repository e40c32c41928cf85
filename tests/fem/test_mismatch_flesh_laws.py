"""Flesh of other laws: exact solutions, closed forms and the samples' laws; each found again.

The coarse fruit's truth is stepped through time on a mesh of its own (drained_flesh).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
from coarse_fruit import HALF_AXES_MM, NU, PIT_HALF_AXES_MM, PIT_MIDDLE_MM, fruit_mesh
from drained_flesh import drained
from fem_shapes import box
from injected_mismatch import (
    E_MPA,
    TIME_S,
    Altered,
    injected_case,
    linear_and_refitted,
    only_grasp,
    small_strain_model,
)
from pinched_case_model import FRAMES, as_case, in_full, long_pinch, model_of
from plain_model import case_model, screened_effects
from scipy.sparse import csr_array

from fem.elements.assembly import unit_lame_constants
from fem.materials.relaxing_arm import RelaxingArm, lagging
from fem.materials.strain_path import linear_stress
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mismatch.effects import (
    anisotropy,
    clock_lag,
    damage,
    drainage,
    graded_modulus,
    plastic_set,
    poisson_ratio,
    skin,
    stiffening,
    viscoelastic,
)
from fem.mismatch.effects.drainage import FadingVolume
from fem.mismatch.effects.viscoelastic import EFFECT
from fem.mismatch.evidence.model_error import model_error_columns
from fem.mismatch.model import stress_history
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse, plain_model
from fem.mismatch.model.reduced_law import ReducedLaw
from fem.mismatch.model.stress_history import path_frames, path_state
from fem.mismatch.model.warm_start import WarmStarts
from fem.mismatch.selection import screening
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.selection.refinement import refit
from fem.mismatch.selection.screening import LinearRound
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.flesh_pieces import FleshPieces
from fem.solid.initial_stress import AddedStress
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.membrane import membrane_stiffness
from fem.solid.rigid_core import reduced, rigid_modes
from fem.solid.strain_field import FleshStrain
from fem.sparse.solver import factorise
from samples.mismatch.flesh_laws import Draining, Lame, PlainFlesh


def test_forces_of_the_linear_stress_are_those_of_the_stiffness_matrix():
    solid = model_of().grasps[0].solid
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
    (frames,) = path_frames([SimpleNamespace(shares=load[:, None])], 10, remembers=True)
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
    size = np.linalg.norm(first - model.grasps[0].tracks.unit_displacement)
    assert size > 0
    # what the first left is there before the second begins, and its peak adds nothing new
    assert np.linalg.norm((second - first)[0]) > 0.02 * size
    assert np.linalg.norm((second - first)[int(model.grasps[0].load.argmax()) :]) < 0.05 * size


MU, LAME = unit_lame_constants(NU)
COUNT = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""How often each component of a symmetric strain counts in a double contraction."""


@cache
def pinched_once() -> CaseModel:
    """One ground for all, which remembers what it has computed."""
    return model_of()


def changed_solid(model: CaseModel, more: csr_array) -> UnitModulusSolid:
    """The plain solid with this added to its stiffness, factorised anew."""
    solid = model.grasps[0].solid
    stiffness = csr_array(solid.stiffness + more)
    return replace(solid, stiffness=stiffness, factor=factorise(reduced(stiffness, solid.kinematics)))


def stiffness_of(model: CaseModel, tangent: np.ndarray) -> csr_array:
    """Sum over points of volume B' C B, element by element; `tangent` (m 4 6 6) in six true components."""
    points = model.points
    m = len(points.volume_mm3)
    B = np.zeros((m, 4, 6, 10, 3))
    for six, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]):
        B[:, :, six, :, i] += points.slope[:, :, j] / 2
        B[:, :, six, :, j] += points.slope[:, :, i] / 2
    B = B.reshape(m, 4, 6, 30)
    stiffness = np.einsum("mq,mqsa,s,mqst,mqtb->mab", points.volume_mm3, B, COUNT, tangent, B, optimize=True)
    dofs = (3 * points.mesh.tets[:, :, None] + np.arange(3)).reshape(m, 30)
    size = 3 * points.n_nodes
    where = (np.repeat(dofs, 30, axis=1).ravel(), np.tile(dofs, (1, 30)).ravel())
    return csr_array((stiffness.ravel(), where), shape=(size, size))


def isotropic() -> np.ndarray:
    tangent = 2 * MU * np.eye(6)
    tangent[:3, :3] += LAME
    return tangent


def graded(model: CaseModel) -> csr_array:
    return stiffness_of(model, (2 * model.depth - 1)[..., None, None] * isotropic())


def axial(model: CaseModel) -> csr_array:
    along = np.zeros((6, 6))
    along[2, 2] = MU
    return stiffness_of(model, np.broadcast_to(along, (*model.depth.shape, 6, 6)))


def membrane(model: CaseModel) -> csr_array:
    return membrane_stiffness(model.mesh, poisson_ratio=NU)


@pytest.mark.parametrize(
    ("effect", "matrix", "value", "off"),
    [
        (skin.EFFECT, membrane, 12.0, 0.08),
        (graded_modulus.EFFECT, graded, 0.8, 0.03),
        (anisotropy.EFFECT, axial, 5.0, 0.01),
    ],
)
def test_the_reduced_space_answers_as_the_law_factorised_in_full(
    effect, matrix: Callable[[CaseModel], csr_array], value, off
):
    model = replace(pinched_once(), beyond_small_strain=False)
    plain = model.grasps[0].tracks.unit_displacement
    expected = in_full(model, changed_solid(model, value * matrix(model))) - plain
    change = effect.respond(model, {effect.spec.searched[0].name: value}, ONE_WAY).unit[0] - plain
    assert np.linalg.norm(expected) > 0.02 * np.linalg.norm(plain)
    assert np.linalg.norm(change - expected) < off * np.linalg.norm(expected)


@pytest.mark.parametrize("nu", [0.35, 0.49])
def test_another_poisson_ratio_answers_as_the_fruit_solved_with_it(nu):
    model = replace(pinched_once(), beyond_small_strain=False)
    plain = model.grasps[0].tracks.unit_displacement
    solid = UnitModulusSolid.factorise(fruit_mesh(), poisson_ratio=nu, support="free")
    expected = in_full(model, solid) - plain
    change = poisson_ratio.EFFECT.respond(model, {"nu": nu}, ONE_WAY).unit[0] - plain
    assert np.linalg.norm(change - expected) < 0.02 * np.linalg.norm(expected)


def test_depth_is_nothing_at_the_skin_and_one_at_the_pit():
    depth, place = pinched_once().depth, pinched_once().points.point_mm
    to_skin = np.linalg.norm(place / HALF_AXES_MM, axis=-1)
    to_pit = np.linalg.norm((place - PIT_MIDDLE_MM) / PIT_HALF_AXES_MM, axis=-1)
    assert 0 <= depth.min() <= depth[to_skin > 0.95].max() < 0.25
    assert 1 >= depth.max() >= depth[to_pit < 1.15].min() > 0.75


@pytest.fixture(scope="module")
def crate() -> FleshMesh:
    """A box of 10 x 8 x 6 mm."""
    return tetrahedralise(*box((10.0, 8.0, 6.0), cells=3), None, None, edge_mm=3.0)


def cost(mesh: FleshMesh, moved: np.ndarray) -> float:
    return float(moved.ravel() @ (membrane_stiffness(mesh, poisson_ratio=NU) @ moved.ravel()))


@pytest.mark.parametrize(
    ("along", "modulus", "area_mm2"),
    [
        pytest.param(0, 1 / (1 - NU**2), 2 * 10 * 8 + 2 * 10 * 6, id="stretched one way, in plane stress"),
        # x = gamma y shears faces across z; those across y and x only turn: bending and turning cost nothing
        pytest.param(1, 1 / (2 * (1 + NU)), 2 * 10 * 8, id="in shear, by its shear modulus"),
    ],
)
def test_a_flat_skin_costs_its_energy(crate, along, modulus, area_mm2):
    strain = 0.03
    moved = np.zeros_like(crate.nodes_mm)
    moved[:, 0] = strain * crate.nodes_mm[:, along]
    assert cost(crate, moved) == pytest.approx(strain**2 * modulus * area_mm2, rel=1e-3)


def test_rigid_motions_stretch_no_skin(solid_ball):
    modes = rigid_modes(solid_ball.nodes_mm, centre_mm=np.array([3.0, -1.0, 2.0]))
    scale = cost(solid_ball, solid_ball.nodes_mm)
    for k in range(6):
        assert abs(cost(solid_ball, modes[:, :, k])) < 1e-9 * scale


def test_an_inflated_sphere_costs_what_its_skin_does(solid_ball):
    radius, more = 20.0, 0.1
    moved = solid_ball.nodes_mm / radius * more
    # twice the energy: both strains a / R, so 2 Et / (1 - nu) (a / R)^2 over 4 pi R^2
    assert cost(solid_ball, moved) == pytest.approx(8 * np.pi * more**2 / (1 - NU), rel=5e-3)


UNEVEN_S = np.concatenate([[0.0, 0.02, 0.1], np.linspace(0.3, 9.0, 25), [12.0, 20.0, 60.0]])


def test_what_lags_behind_a_ramp_and_a_hold_is_their_closed_form_at_any_steps():
    T, end = 1.7, 3.0
    time = np.unique(np.append(UNEVEN_S, end))
    lag = lagging((np.minimum(time, end)[:, None, None] * np.ones((1, 1, 3))), time, T)[:, 0, 0]
    during = time - T * -np.expm1(-time / T)
    at_end = end - T * -np.expm1(-end / T)
    after = end + (at_end - end) * np.exp(-(time - end) / T)
    np.testing.assert_allclose(lag, np.where(time <= end, during, after), atol=1e-12)


def crept(force: np.ndarray, time_s: np.ndarray, g: float, tau_s: float) -> np.ndarray:
    """Displacement of the law E (1 - g + g exp(-t / tau)) under a force, by its own creep compliance.

    J(t) = 1 + g / (1 - g) (1 - exp(-t / T)), T = tau / (1 - g) (Laplace transform of 1 / (s^2 E(s)));
    sum over the force's straight pieces of slope times the integral of J. What is there at first has been
    there for long.
    """
    T = tau_s / (1 - g)

    def integral(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0)
        return t + g / (1 - g) * (t - T * -np.expm1(-t / T))

    slopes = np.diff(force) / np.diff(time_s)
    grown = [
        slope * (integral(time_s - a) - integral(time_s - b))
        for slope, a, b in zip(slopes, time_s[:-1], time_s[1:], strict=True)
    ]
    return force[0] / (1 - g) + np.sum(grown, axis=0)


def relaxed(unit: np.ndarray, *, g: float, tau_s: float) -> np.ndarray:
    """Displacements of a recording, each of them crept."""
    flat = unit.reshape(len(unit), -1)
    return np.stack([crept(course, TIME_S, g, tau_s) for course in flat.T], axis=1).reshape(unit.shape)


@pytest.mark.parametrize(("g", "tau_s"), [(0.3, 0.4), (0.6, 5.0)])
def test_the_model_creeps_as_the_convolution_says(g, tau_s):
    model = model_of()
    recording = model.grasps[0]
    response = EFFECT.respond(model, {"g": g, "tau_s": tau_s}, ONE_WAY).unit[0]
    plain = recording.tracks.unit_displacement
    time = recording.case.history.time_s
    for marker in (3, 30):
        for way in range(3):
            expected = crept(plain[:, marker, way], time, g, tau_s)
            np.testing.assert_allclose(response[:, marker, way], expected, atol=1e-9)


def test_a_start_has_the_retardation_time_of_its_signature():
    model = model_of()
    start = EFFECT.start(model, EFFECT.signatures(model)[2], np.array([0.5]))
    assert start["g"] / (1 - start["g"]) == pytest.approx(0.5)
    assert start["tau_s"] / (1 - start["g"]) == pytest.approx(3.0)


def test_frames_that_were_not_used_are_filled_in_straight_lines_and_nil_in_the_air():
    model, _ = case_model(only_grasp(injected_case(), 0))
    recording = model.grasps[0]
    values = np.random.default_rng(0).normal(size=recording.tracks.position_mm.shape)
    whole = recording.over_all_frames(values)
    np.testing.assert_array_equal(whole[recording.used], values)
    np.testing.assert_array_equal(whole[:3], 0)
    last, before = np.flatnonzero(recording.used)[[5, 3]]
    fewer = recording.used.copy()
    fewer[before + 1 : last] = False
    time, kept = recording.case.history.time_s, whole[fewer]
    filled = replace(recording, used=fewer).over_all_frames(kept)
    share = (time[before + 1] - time[before]) / (time[last] - time[before])
    expected = (1 - share) * whole[before] + share * whole[last]
    np.testing.assert_allclose(filled[before + 1], expected, atol=1e-12)


def test_flesh_that_relaxes_is_found():
    g, tau_s = 0.4, 1.2
    case = only_grasp(injected_case(crept=partial(relaxed, g=g, tau_s=tau_s)), 1)
    _, _, again = linear_and_refitted(case, EFFECT)
    (parameters,) = again.parameters
    assert parameters["g"] == pytest.approx(g, rel=0.06)
    assert parameters["tau_s"] == pytest.approx(tau_s, rel=0.08)
    E = 1 / (again.model.compliance * (1 + again.fit.amounts[0]))
    assert pytest.approx(E_MPA, rel=0.04) == E


EFFECTS = [drainage.EFFECT, viscoelastic.EFFECT, poisson_ratio.EFFECT, clock_lag.EFFECT]
COARSE_MESH = {"poisson_ratio": 0.167}
"""Model error here: the finder's mesh is so coarse that its error looks like that of Poisson's ratio."""


def uniform_strain() -> ReducedLaw:
    """A cube of 1 mm3 in uniform strain along its axes, pulled at one pair of faces."""
    shear, volume = 2 * np.eye(3), np.ones((3, 3))
    shares = np.linspace(0.0, 1.0, FRAMES)[:, None] ** 0.3
    nothing = np.zeros((FRAMES, 1, 3))
    return ReducedLaw(
        parts=np.stack([shear, volume]),
        load=np.array([[0.01], [0.0], [0.0]]),
        recording=np.eye(3)[:, None],
        shares=shares,
        unchanged=nothing,
    )


@pytest.mark.parametrize(("share", "tau_s"), [(0.3, 0.2), (0.9, 0.05), (0.9, 2.0)])
def test_the_samples_law_gives_back_the_pull_from_the_strain(share: float, tau_s: float):
    law = uniform_strain()
    recording = model_of().grasps[0]

    def strained(law: ReducedLaw, recording: GraspResponse) -> np.ndarray:
        volume = FadingVolume.of(law, mu=MU, lame=LAME)
        return (law.response((MU, LAME)) + volume.change(recording, share=share, tau_s=tau_s))[:, 0]

    strain = strained(law, recording)
    # between frames the forces run straight: the strain there, by the same modes on a finer grid of times
    history = recording.case.history
    fine_s = np.linspace(0, history.time_s[-1], 70 * (FRAMES - 1) + 1)
    finer = replace(
        recording,
        used=np.ones(len(fine_s), dtype=bool),
        case=replace(recording.case, history=replace(history, time_s=fine_s, pads=())),
    )
    shares = np.interp(fine_s, history.time_s, law.shares[:, 0])[:, None]
    fine_law = replace(law, shares=shares, unchanged=np.zeros((len(fine_s), 1, 3)))
    fine = strained(fine_law, finer)
    np.testing.assert_allclose(fine[::70], strain, atol=1e-12)
    truth = Draining(plain=PlainFlesh(lame=Lame(mu=MU, lam=LAME)), volume_share=share, tau_s=tau_s)
    small = 1e-3  # of the strain: the samples' law is of finite strain
    state = truth.at_first((1,))
    for step in range(1, len(fine_s)):
        H = small * np.diag(fine[step])[None]
        stress, state = truth.stress(H, state, float(fine_s[step] - fine_s[step - 1]))
        np.testing.assert_allclose(stress[0] / small, np.diag([0.01 * shares[step, 0], 0, 0]), atol=3e-5)


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_drained_flesh_is_elastic_flesh_with_what_is_left_of_lambda(share: float):
    model = model_of()
    (recording,) = model.grasps
    gone = {"volume_share": share, "tau_s": 1e-6}
    response = drainage.EFFECT.respond(model, gone, ONE_WAY).unit[0]
    left = (1 - share) * LAME
    ratio = left / (2 * (left + MU))
    solid = UnitModulusSolid.factorise(model.mesh, poisson_ratio=ratio, support="free")
    solid = replace(solid, contact_nodes=recording.solid.contact_nodes)
    leading = recording.leading
    moved = solid.displacement(recording.loads(recording.patterns[leading])) / (2 * MU * (1 + ratio))
    change = recording.at_markers(moved) - recording.response[leading]
    expected = np.tensordot(recording.shares[:, leading], change, axes=1)
    more = response - recording.tracks.unit_displacement
    assert np.linalg.norm(more - expected) < 0.01 * np.linalg.norm(expected)
    assert np.linalg.norm(expected) > 0.03 * np.linalg.norm(recording.tracks.unit_displacement)


def rounds(altered: Altered, **options: object):
    model = small_strain_model(injected_case(altered, **options))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(screening, "model_error_columns", partial(model_error_columns, shares=COARSE_MESH))
        return model, screened_effects(model, EFFECTS)


def gains(linear: LinearRound) -> dict[str, float]:
    return {linear_fit.effect.spec.name: linear_fit.gain for linear_fit in linear.best}


@pytest.mark.parametrize(
    ("share", "least_gain", "share_off", "tau_off"),
    [pytest.param(0.85, 2000, 0.05, 0.12, marks=pytest.mark.proof), (0.4, 150, 0.05, 0.15)],
)
def test_draining_flesh_is_found_with_its_share_its_time_and_the_modulus(
    share: float, least_gain: float, share_off: float, tau_off: float
):
    tau_s = 0.8
    model, linear = rounds(drained(share, tau_s))
    best, second = linear.best[:2]
    assert best.effect is drainage.EFFECT
    assert best.gain > max(least_gain, second.gain + 50)
    again = refit(model, linear, [best])
    (parameters,) = again.parameters
    assert parameters["volume_share"] == pytest.approx(share, abs=share_off)
    assert parameters["tau_s"] == pytest.approx(tau_s, rel=tau_off)
    assert modulus_of(again.model, again.response).value == pytest.approx(E_MPA, rel=0.02)


def test_an_unaltered_fruit_does_not_seem_to_drain():
    _, linear = rounds(lambda pad: pad)
    assert gains(linear)["drainage"] < 1.0


def test_flesh_whose_whole_resistance_fades_is_viscoelastic():
    def relaxed(unit: np.ndarray) -> np.ndarray:
        arm = RelaxingArm(g=0.3, tau_s=0.8)
        return unit + arm.creep_share * lagging(unit, TIME_S, arm.retardation_s)

    _, linear = rounds(lambda pad: pad, crept=relaxed)
    gain_of = gains(linear)
    assert linear.best[0].effect is viscoelastic.EFFECT
    assert gain_of["viscoelastic"] > gain_of["drainage"] + 50
