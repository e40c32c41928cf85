"""How a gel's face gives way, by closed forms and another library's finite elements."""

from functools import lru_cache

import numpy as np
import pytest
from periodic_slab import traction_response
from scipy.sparse.linalg import splu
from skfem import (
    Basis,
    BilinearForm,
    ElementHex2,
    ElementVector,
    FacetBasis,
    LinearForm,
    MeshHex,
)
from skfem.helpers import ddot, eye, sym_grad, trace

from tactile.gel.gel_sides import GelOutline, side_response
from tactile.gel.slab import GelSlab, tent_compliance

SOFT = GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)


def test_even_pressure_meets_the_oedometric_modulus_and_even_shear_the_shear_modulus() -> None:
    load = np.broadcast_to([0.01, 0.02, -0.05], (8, 8, 3))
    moved = traction_response(SOFT, load, spacing_mm=1.0)
    mu = 0.2 / (2 * 1.48)
    oedometric = 0.2 * 0.52 / (1.48 * 0.04)
    expected = [0.01 * 4 / mu, 0.02 * 4 / mu, -0.05 * 4 / oedometric]
    np.testing.assert_allclose(moved, np.broadcast_to(expected, moved.shape), rtol=1e-6)


@pytest.mark.parametrize("nu", [0.2, 0.35, 0.499])
def test_a_thick_slab_is_the_half_space_of_boussinesq_and_cerruti(nu: float) -> None:
    """The transforms of 1/r and of its gradients: with k h of 40 to 2e6 the back is out of reach."""
    E, k = 0.3, np.array([2.0, 5.0, 1e5])
    spectrum = GelSlab(thickness_mm=20.0, E_MPa=E, nu=nu).spectrum(k) * k[:, None]
    boussinesq, drawn = 2 * (1 - nu**2) / E, (1 + nu) * (1 - 2 * nu) / E
    across = 2 * (1 + nu) / E
    np.testing.assert_allclose(spectrum, np.tile([boussinesq, drawn, boussinesq, across], (3, 1)), rtol=1e-7)


def test_one_tents_table_is_what_the_grid_of_wave_vectors_gives() -> None:
    """All nine components at points off every axis, through the complex transforms of the whole plane."""
    slab, pitch, fine = GelSlab(thickness_mm=1.5, E_MPa=0.3, nu=0.46), 0.8, 0.1
    axis = fine * np.arange(-200, 200)
    tent = np.maximum(1 - np.abs(axis) / pitch, 0) / pitch
    at = np.array([[0.3, 1.1], [-0.7, 0.4], [1.9, -0.2], [-1.2, -2.3]])
    C = tent_compliance(slab, at, np.zeros((1, 2)), pitch_mm=pitch)
    rows, columns = (np.rint(at / fine).astype(int) + 200).T
    for force in range(3):
        traction = np.zeros((400, 400, 3))
        traction[..., force] = tent[:, None] * tent
        moved = traction_response(slab, traction, spacing_mm=fine)
        np.testing.assert_allclose(C[:, :, 0, force], moved[rows, columns], atol=2e-4 * np.abs(C).max())


E_MPA, NU, THICKNESS_MM, PITCH_MM = 0.2, 0.45, 3.0, 1.0
SIZE_MM = (12.0, 9.0)
AT_MM = np.array([[-3.0, 0.0], [-5.0, 3.5], [5.5, 0.0], [0.0, -4.0], [4.5, 4.0], [-2.0, -4.4]])
UNDER_LOAD_MM = np.array([[1.5, 0.5]])
LOADED_MM = np.array([[1.0, 0.0], [2.0, 0.0], [1.0, 1.0], [2.0, 1.0]])


DOME = (40.0, 30.0)
"""Radii of a face that falls by 0.45 and 0.34 mm to the sides: a quarter of the thickness in the corners."""


@lru_cache
def by_elements(*, bonded: bool, domed: bool = False) -> dict[int, np.ndarray]:
    """Displacement (mm) at AT_MM and UNDER_LOAD_MM under a newton on each tent, by the axis it acts along.

    A domed gel's bricks are straight (the face is bilinear between nodes 0.5 mm apart).
    """
    per_mm = 2 if domed else 1
    x, y = (np.linspace(-size / 2, size / 2, per_mm * round(size) + 1) for size in SIZE_MM)
    mesh = MeshHex.init_tensor(x, y, np.linspace(-THICKNESS_MM, 0, 4))

    def face_mm(place):
        return -sum(place[k] ** 2 / (2 * DOME[k]) for k in (0, 1)) if domed else 0.0 * place[0]

    flat = mesh.p
    lifted = flat[2] + face_mm(flat) * (flat[2] + THICKNESS_MM) / THICKNESS_MM
    mesh = MeshHex(np.vstack([flat[:2], lifted]), mesh.t)
    element = ElementVector(ElementHex2())
    basis = Basis(mesh, element, intorder=4)
    lame, mu = E_MPA * NU / ((1 + NU) * (1 - 2 * NU)), E_MPA / (2 * (1 + NU))

    @BilinearForm
    def stiffness(u, v, _):
        strain = sym_grad(u)
        return ddot(lame * eye(trace(strain), 3) + 2 * mu * strain, sym_grad(v))

    def load(way: int) -> np.ndarray:
        @LinearForm
        def tents(v, w):
            along = [
                np.maximum(1 - np.abs(w.x[k] - LOADED_MM[:, k, None, None]) / PITCH_MM, 0) for k in (0, 1)
            ]
            return (along[0] * along[1]).sum(axis=0) / PITCH_MM**2 * v[way]

        return np.asarray(tents.assemble(top))

    on_top = mesh.facets_satisfying(lambda p: p[2] > face_mm(p) - 0.02, boundaries_only=True)
    top = FacetBasis(mesh, element, facets=on_top, intorder=12)
    held = basis.get_dofs(lambda p: p[2] < -THICKNESS_MM + 1e-9).all()
    if bonded:
        at_side = lambda p: (np.abs(p[0]) > SIZE_MM[0] / 2 - 1e-9) | (np.abs(p[1]) > SIZE_MM[1] / 2 - 1e-9)  # noqa: E731
        held = np.union1d(held, basis.get_dofs(at_side).all())
    free = basis.complement_dofs(held)
    stiff = stiffness.assemble(basis).tocsr()[free][:, free].tocsc()
    solver = splu(stiff, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    at = np.vstack([AT_MM, UNDER_LOAD_MM])
    points = np.vstack([at.T, face_mm(at.T) - (0.02 if domed else 1e-9)])
    read = basis.probes(points).tocsr()[:, free]
    return {way: (read @ solver.solve(load(way)[free])).reshape(3, -1).T for way in (0, 2)}


@pytest.mark.parametrize(
    ("outline", "simpler", "most"),
    [
        (GelOutline(SIZE_MM), None, 0.01),
        (GelOutline(SIZE_MM, sides="bonded"), None, 0.01),
        pytest.param(
            GelOutline(SIZE_MM, face_radius_mm=DOME), GelOutline(SIZE_MM), 0.004, marks=pytest.mark.proof
        ),
    ],
    ids=["free", "bonded", "domed"],
)
@pytest.mark.parametrize("way", [0, 2])
def test_a_gel_with_sides_moves_as_another_librarys_elements_say(
    way: int, outline: GelOutline, simpler: GelOutline | None, most: float
) -> None:
    *truth, under_load = by_elements(bonded=outline.sides == "bonded", domed=outline.domed)[way]
    misses = []
    for described in (outline, simpler):
        slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, outline=described)
        response = tent_compliance(slab, AT_MM, LOADED_MM, pitch_mm=PITCH_MM)[..., way].sum(axis=2)
        misses.append(np.abs(response - truth).max() / np.abs(under_load).max())
    assert misses[0] < most
    assert misses[1] > 5 * misses[0]


def test_far_sides_change_nothing() -> None:
    wide = side_response(THICKNESS_MM, NU, GelOutline((40.0, 40.0)))
    change = wide.between(np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0) / E_MPA
    slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU)
    compliance = tent_compliance(slab, np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0)
    assert np.abs(change).max() < 1e-3 * np.abs(compliance).max()
