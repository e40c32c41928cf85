"""A soft ball in the flesh: its stiffness, its response, its signature, and that it is found where it is."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import HALF_AXES_MM, NU
from fem_shapes import ball
from pinched_case_model import COMPLIANCE, in_full, model_of, pinched

from fem.elements.assembly import unit_lame_constants
from fem.mesh.flesh_mesh import tetrahedralise
from fem.mismatch.effects.soft_spot import CENTRE, EFFECT
from fem.mismatch.localisation.spot_search import OTHERS, RADII_MM, best_spots
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.inclusion import ball_stiffness, drop_of
from fem.solid.linear_solid import UnitModulusSolid
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
    strain = np.diag([0.01, -0.01, 0.0])
    moved = (mesh.nodes_mm @ strain)[None]
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
