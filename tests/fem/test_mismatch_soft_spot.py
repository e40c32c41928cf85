"""A soft ball in the flesh and a third body that bears the fruit: response, signature and place.

The truth is solved on a mesh of its own, pads and third contact together in equilibrium.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse_fruit import FOOT_MM, HALF_AXES_MM, NU
from fem_shapes import ball
from injected_mismatch import (
    E_MPA,
    GEL_N_PER_MM,
    NAMES,
    Altered,
    Recording,
    bare_pad,
    injected_case,
    linear_and_refitted,
    misplaced,
    on_pad,
    true_mesh,
    true_pads,
    true_solid,
)
from pinched_case_model import COMPLIANCE, in_full, model_of, pinched
from plain_model import case_model, screened_effects

from fem.elements.assembly import unit_lame_constants
from fem.estimation.compliance_fit import fit_compliance
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import tetrahedralise
from fem.mesh.surface_points import locate
from fem.mismatch.effects import pose_error, sensor_gain, third_contact
from fem.mismatch.effects.soft_spot import CENTRE, EFFECT
from fem.mismatch.effects.third_contact import ForceBalance, best_contact
from fem.mismatch.localisation.residual_places import located, modulus_cells
from fem.mismatch.localisation.spot_search import OTHERS, RADII_MM, best_spots, fruit_map
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, MARKER_VARIANCE_INFLATION
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.inclusion import ball_stiffness, drop_of
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes, pad_link
from fem.solid.rigid_core import reduced
from fem.sparse.solver import factorise

SPOT_MM = np.array([HALF_AXES_MM[0] - 4.5, 1.0, -0.5])
TRUTH = {**dict(zip(CENTRE, SPOT_MM, strict=True)), "radius_mm": 4.5, "ratio": 0.35}


def softened_solid(solid: UnitModulusSolid, *, centre_mm, radius_mm, ratio) -> UnitModulusSolid:
    """The same solid with the ball in its stiffness, factorised anew."""
    inside = ball_stiffness(
        solid.mesh, centre_mm=centre_mm, radius_mm=radius_mm, poisson_ratio=solid.poisson_ratio
    )
    stiffness = (solid.stiffness - (1 - ratio) * inside).tocsr()
    return replace(solid, stiffness=stiffness, factor=factorise(reduced(stiffness, solid.kinematics)))


def responded(model, **changes: float) -> np.ndarray:
    return EFFECT.respond(model, {**TRUTH, **changes}, ONE_WAY).unit[0]


def test_stiffness_of_the_ball_is_its_volume_times_the_energy_density_of_a_uniform_strain(solid_ball):
    radius, strain = 7.0, np.array([[0.02, 0.01, 0.0], [0.01, -0.015, 0.004], [0.0, 0.004, 0.01]])
    inside = ball_stiffness(
        solid_ball, centre_mm=np.array([3.0, -2.0, 1.0]), radius_mm=radius, poisson_ratio=NU
    )
    moved = (solid_ball.nodes_mm @ strain).ravel()
    mu, lame = unit_lame_constants(NU)
    density = 2 * mu * (strain**2).sum() + lame * np.trace(strain) ** 2
    assert moved @ (inside @ moved) == pytest.approx(4 / 3 * np.pi * radius**3 * density, rel=0.01)


def test_reduced_space_agrees_with_a_solid_factorised_with_the_ball_in_it():
    base = pinched()
    recording, solid = base.grasps[0], base.grasps[0].solid
    exact = softened_solid(solid, centre_mm=SPOT_MM, radius_mm=4.5, ratio=0.35)
    expected = in_full(model_of(), exact)
    plain = recording.tracks.unit_displacement
    more = responded(replace(model_of(), beyond_small_strain=False)) - plain
    assert np.linalg.norm(more - (expected - plain)) < 0.02 * np.linalg.norm(expected - plain)


def test_soft_ball_in_a_large_body_gives_way_as_eshelby_says():
    mesh = tetrahedralise(*ball(3000, semi_axes_mm=(12, 12, 12)), None, None, edge_mm=2.4)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free")
    moved = (mesh.nodes_mm @ np.diag([0.01, -0.01, 0.0]))[None]
    load = (solid.stiffness @ moved.ravel()).reshape(moved.shape)
    inside = ball_stiffness(mesh, centre_mm=np.zeros(3), radius_mm=3.0, poisson_ratio=NU)
    ratio = 0.3
    softened = softened_solid(solid, centre_mm=np.zeros(3), radius_mm=3.0, ratio=ratio).displacement(load)
    more = float(((softened - solid.displacement(load)) * load).sum())
    first_order = float(moved.ravel() @ (inside @ moved.ravel()))
    assert more / first_order == pytest.approx(drop_of(ratio, NU), rel=0.05)


def test_signature_is_the_slope_of_the_model_at_no_drop():
    model = model_of()
    small = 1e-3
    injected = model_of(COMPLIANCE * (responded(model) - model.grasps[0].tracks.unit_displacement))
    place = dict(zip((*CENTRE, "radius_mm"), EFFECT.signatures(injected)[1].variant.values, strict=True))
    slope = responded(injected, **place, ratio=1 - small) - responded(injected, **place, ratio=1.0)
    given = EFFECT.signatures(injected)[1].columns[0].fields[0].markers
    assert np.linalg.norm(COMPLIANCE * slope / small - given) < 0.01 * np.linalg.norm(given)


def test_injected_spot_is_found_where_it_is_and_started_near_its_ratio():
    plain = model_of()
    rng = np.random.default_rng(3)
    more = COMPLIANCE * (responded(plain) - plain.grasps[0].tracks.unit_displacement)
    model = model_of(more + 0.004 * rng.normal(size=more.shape))
    signatures = EFFECT.signatures(model)
    assert len(signatures) <= 6
    nearest = min(signatures, key=lambda signature: np.linalg.norm(signature.variant.values[:3] - SPOT_MM))
    start = EFFECT.start(model, nearest, np.array([0.9]))
    assert 0.1 <= start["ratio"] <= 0.6
    place = EFFECT.where(start)
    assert place.region == "flesh"
    assert np.linalg.norm(np.array(place.centre_mm) - SPOT_MM) < 3.0


def test_without_a_spot_nothing_stands_out():
    """The greatest score of some hundred places by noise alone, against that of the injected spot."""

    def most(more: np.ndarray) -> float:
        model = model_of(more)
        left = [
            tracks.position_mm - tracks.place_mm - COMPLIANCE * tracks.unit_displacement
            for tracks in (recording.tracks for recording in model.grasps)
        ]
        observed = model.adjoint_basis.observed(left)
        spots = best_spots(model, observed, radii_mm=RADII_MM, others=OTHERS)
        return max((spot.score for spot in spots), default=0.0)

    plain = model_of()
    change = COMPLIANCE * (responded(plain) - plain.grasps[0].tracks.unit_displacement)
    noise = 0.004 * np.random.default_rng(4).normal(size=change.shape)
    assert most(noise) < 4.0
    assert most(change + noise) > 8.0


@pytest.mark.parametrize(
    ("centre_mm", "share"), [((0.0, 0.0, 90.0), 1e-9), ((0.0, 0.0, -18.2), 1e-4), ((0.0, 21.3, 0.0), 1e-4)]
)
def test_a_ball_that_bears_nothing_leaves_the_fruit_as_it_is(centre_mm, share):
    """Outside of the flesh, or where next to nothing of the load passes."""
    place = dict(zip(CENTRE, centre_mm, strict=True))
    plain = pinched().grasps[0].tracks.unit_displacement
    response = responded(model_of(), **place, radius_mm=3.0)
    np.testing.assert_allclose(response, plain, atol=share * np.abs(plain).max())


NOISE_MM = 0.004


def left_by_plain(model: CaseModel) -> list[np.ndarray]:
    tracks = model.grasps[0].tracks
    return [tracks.position_mm - tracks.place_mm - COMPLIANCE * tracks.unit_displacement]


def injected_spot(rng: np.random.Generator) -> CaseModel:
    plain = model_of()
    place = {**dict(zip(CENTRE, SPOT_MM, strict=True)), "radius_mm": 4.5, "ratio": 0.35}
    more = EFFECT.respond(plain, place, ONE_WAY).unit[0] - plain.grasps[0].tracks.unit_displacement
    return model_of(COMPLIANCE * more + NOISE_MM * rng.normal(size=more.shape))


def test_map_of_the_modulus_is_softest_above_the_injected_spot():
    model = injected_spot(np.random.default_rng(0))
    maps = fruit_map(model, model.adjoint_basis.observed(left_by_plain(model)))
    softest = maps.vertices_mm[maps.modulus_score.argmin()]
    assert np.linalg.norm(softest - [HALF_AXES_MM[0], 1.0, -0.5]) < 5.0
    assert maps.modulus_score.min() < -10


def test_injected_spot_is_named_with_its_place():
    """By the best single ball for what the plain model leaves, as the signature's start has it."""
    model = injected_spot(np.random.default_rng(1))
    residual = model.adjoint_basis.observed(left_by_plain(model))
    best = max(best_spots(model, residual, radii_mm=RADII_MM, others=OTHERS), key=lambda spot: spot.score)
    assert best.score**2 > 0.7 * float(residual @ residual)
    place = EFFECT.where(dict(zip((*CENTRE, "radius_mm"), (*best.centre_mm, best.radius_mm), strict=True)))
    assert place.region == "flesh"
    assert np.linalg.norm(np.array(place.centre_mm) - SPOT_MM) < 3.0


def test_fault_of_one_pads_shear_is_named_so():
    model = model_of()
    recording = model.grasps[0]
    rough = np.zeros_like(recording.tracks.position_mm)
    on_pad = recording.pad_of_marker == 1
    wave = np.sin(3 * recording.tracks.place_mm[on_pad, 1]) * (-1.0) ** np.arange(on_pad.sum())
    rough[:, on_pad, 2] = 0.05 * np.sin(np.arange(len(rough)))[:, None] * wave
    rng = np.random.default_rng(2)
    region, _, component = located(model, [rough + NOISE_MM * rng.normal(size=rough.shape)])
    assert (region, component) == ("pad right", "shear")


def test_noise_alone_has_standard_scores_and_no_place():
    rng = np.random.default_rng(3)
    model = model_of()
    shape = model.grasps[0].tracks.position_mm.shape
    maps = [
        fruit_map(model, model.adjoint_basis.observed([NOISE_MM * rng.normal(size=shape)])) for _ in range(20)
    ]
    # Recordings leave ALIKE numbers for each independent one; these draws are independent all.
    thinned = np.sqrt(DESIGN_EFFECT * MARKER_VARIANCE_INFLATION)
    scores = thinned * np.array([map_.modulus_score for map_ in maps])
    # Scores allow for errors of markers' scales too, which these draws have none of.
    assert 0.3 < np.sqrt((scores**2).mean()) < 1.2
    assert located(model, [NOISE_MM * rng.normal(size=shape)]) == ("both", "all", "both")


def test_a_soft_spot_far_from_every_pad_is_not_visible():
    maps = fruit_map(model := model_of(), model.adjoint_basis.observed(left_by_plain(model)))
    under_pad = np.linalg.norm(maps.vertices_mm - [HALF_AXES_MM[0], 0, 0], axis=1).argmin()
    assert maps.visible[under_pad] > 10 * maps.visible[maps.vertices_mm[:, 2].argmax()]


def test_table_of_the_modulus_gives_it_back():
    rng = np.random.default_rng(7)
    model = model_of(1e-4 * rng.normal(size=model_of().grasps[0].tracks.position_mm.shape))
    fits = [fit_compliance(model.grasps[0].tracks, scale_sd=0.004, fruit_moves=True)]
    cells = modulus_cells(model, fits)
    moduli = [cell.E_MPa for cell in cells if cell.E_sd_MPa < 0.02 * cell.E_MPa]
    assert np.median(moduli) == pytest.approx(1 / COMPLIANCE, rel=0.02)


PLACE_MM = np.array([0.0, 0.0, FOOT_MM])
UPWARDS = np.array([0.0, 0.0, 1.0])
PEAK_N = 0.3


def pushed_N(grasp: int, *, late: bool) -> np.ndarray:
    """The third contact's force: as the pads push, or only over half of their greatest."""
    normal = true_pads()[grasp][0].force_N @ true_pads()[grasp][0].axes[:, 2]
    share = normal.sum(axis=1) / normal.sum(axis=1).max()
    return PEAK_N * (2 * np.maximum(share - 0.5, 0.0) if late else share)


@cache
def third_contact_truth(
    late: bool, only: int | None
) -> dict[tuple[str, bytes], tuple[np.ndarray, np.ndarray]]:
    """By pad and its axes: what is added to its markers' forces, N, and to their displacement for E = 1 MPa.

    Both pads are drawn back by half of the third force each, evenly with their push.
    """
    mesh, by_pad = true_mesh(), {}
    for grasp, pads in enumerate(true_pads()):
        force = pushed_N(grasp, late=late) * (only in (None, grasp))
        bare = [bare_pad(grasp, side, name, mesh) for name, side in zip(NAMES, (-1.0, 1.0), strict=True)]
        history = GraspHistory(
            time_s=np.arange(len(force)) * 1.0, phase=("load",) * len(force), pads=tuple(bare)
        )
        solid = replace(true_solid(), contact_nodes=contact_nodes(mesh, [history]))
        links = [pad_link(pad, solid) for pad in bare]
        extra = []
        for pad in pads:
            push = pad.force_N @ pad.axes[:, 2]
            share = push / np.maximum(push.sum(axis=1, keepdims=True), 1e-12)
            extra.append(-0.5 * (force[:, None] * share)[..., None] * UPWARDS)
        loads = locate(mesh, PLACE_MM[None]).point_load(force[:, None, None] * UPWARDS)
        loads[:, solid.contact_nodes] += sum(
            link.nodal_force(force_N) for link, force_N in zip(links, extra, strict=True)
        )
        assert np.abs(loads.sum(axis=1)).max() < 1e-9
        moved = solid.displacement(loads)[:, solid.contact_nodes]
        for pad, link, force_N in zip(pads, links, extra, strict=True):
            by_pad[pad.name, pad.axes.tobytes()] = (force_N, link.at_markers(moved))
    return by_pad


@cache
def borne(late: bool, only: int | None = None) -> Altered:
    """Every pad as it is where something bears the fruit from below."""
    truth = third_contact_truth(late, only)

    def change(pad: Recording) -> Recording:
        force, unit = truth[pad.name, pad.axes.tobytes()]
        return replace(
            pad,
            force_N=pad.force_N + force,
            gel_mm=pad.gel_mm - (force @ pad.axes / GEL_N_PER_MM) @ pad.axes.T,
            position_mm=pad.position_mm + unit / E_MPA,
        )

    return change


@cache
def model_of_grasp(altered: Altered) -> CaseModel:
    return case_model(injected_case(altered))[0]


@pytest.fixture
def palm() -> CaseModel:
    return model_of_grasp(borne(False))


def normal_N(model: CaseModel) -> list[np.ndarray]:
    contact = best_contact(model)
    return [np.zeros(1) if force is None else force.force_N @ contact.seat.inward for force in contact.forces]


def test_a_palm_is_found_with_its_place_its_push_and_the_modulus():
    model, linear, again = linear_and_refitted(injected_case(borne(False)), third_contact.EFFECT)
    assert linear.best[0].gain > 100
    (parameters,) = again.parameters
    assert [parameters[name] for name in third_contact.CENTRE] == pytest.approx(PLACE_MM.tolist(), abs=1.0)
    assert parameters[third_contact.FORCE] == pytest.approx(PEAK_N, rel=0.05)
    assert again.converged
    assert modulus_of(model, again.response).value == pytest.approx(E_MPA, rel=0.03)
    assert again.fit.chi2 < linear.null.chi2


@pytest.mark.parametrize("late", [False, True], ids=["a palm", "a stop that is touched late"])
def test_the_force_is_what_the_pads_do_not_balance(late: bool):
    model = model_of_grasp(borne(late))
    for grasp, force in enumerate(normal_N(model)):
        true = pushed_N(grasp, late=late)[model.grasps[grasp].used]
        # but for what is common to all frames, which the fruit's own weight may be
        assert force - force.mean() == pytest.approx(true - true.mean(), abs=0.1 * PEAK_N)


@pytest.mark.proof
def test_a_contact_in_one_recording_alone_is_found_in_that_one():
    first, second = normal_N(model_of_grasp(borne(False, 1)))
    assert np.abs(first).max() < 0.1 * PEAK_N
    assert second.max() == pytest.approx(PEAK_N, rel=0.07)


def test_the_balance_with_a_force_at_another_place_explains_less(palm: CaseModel):
    recording = palm.grasps[0]
    equations = palm.balance_equations(recording)
    assert equations is not None
    balance = ForceBalance.of(recording, equations)
    here = balance.force(PLACE_MM, UPWARDS)
    aside = np.array([0.0, 13.0, -13.0])
    elsewhere = balance.force(aside, -aside / np.linalg.norm(aside))
    assert here.evidence > (0.0 if elsewhere is None else elsewhere.evidence) + 100
    assert balance.force(-PLACE_MM, -UPWARDS) is None, "from above it would have to pull"
    under_pad = recording.tracks.place_mm[(recording.touching).any(axis=0)][0]
    assert balance.force(under_pad, UPWARDS) is None


@pytest.mark.parametrize(
    ("altered", "name"),
    [
        (lambda pad: pad, "sensor_gain"),
        pytest.param(
            on_pad("left", lambda pad: replace(pad, force_N=1.1 * pad.force_N)),
            "sensor_gain",
            marks=pytest.mark.proof,
        ),
        (on_pad("left", misplaced((2.0, -1.5), 4.0)), "pose_error"),
        (None, "third_contact"),  # solved when the test runs, not when it is collected
    ],
    ids=["null case", "a pad that reads 10 % too much", "a pad that is elsewhere and turned", "a palm"],
)
def test_what_bears_the_fruit_is_told_from_what_only_unbalances_it(altered: Altered | None, name: str):
    model = model_of_grasp(altered or borne(False))
    effects = [third_contact.EFFECT, sensor_gain.EFFECT, pose_error.EFFECT]
    linear = screened_effects(model, effects)
    gains = {"third_contact": -20.0} | {fit.effect.spec.name: fit.gain for fit in linear.best}
    others = [gain for other, gain in gains.items() if other != name]
    assert gains[name] - 10 > (max(others) if name == "third_contact" else gains["third_contact"])
