"""Flesh of other linear laws: reduced space against full factorisation; the skin against closed forms."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse_fruit import HALF_AXES_MM, NU, PIT_HALF_AXES_MM, PIT_MIDDLE_MM, fruit_mesh
from fem_shapes import box
from pinched_case_model import in_full, model_of
from scipy.sparse import csr_array

from fem.elements.assembly import unit_lame_constants
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mismatch.effects import anisotropy, graded_modulus, poisson_ratio, skin
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.membrane import membrane_stiffness
from fem.solid.rigid_core import reduced, rigid_modes
from fem.sparse.solver import factorise

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
