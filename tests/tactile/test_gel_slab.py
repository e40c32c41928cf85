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

from samples.gel_press import gel_block
from tactile.gel.gel_sides import GelOutline, GelSides, side_response
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.readers.sensor_file import read_sensor
from tactile.tactile_failure import TactileFailure

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
    """The transforms of 1/r and of its gradients: with k h = 40 the back is out of reach."""
    E, k = 0.3, np.array([2.0, 5.0])
    spectrum = GelSlab(thickness_mm=20.0, E_MPa=E, nu=nu).spectrum(k) * k[:, None]
    boussinesq, drawn = 2 * (1 - nu**2) / E, (1 + nu) * (1 - 2 * nu) / E
    across = 2 * (1 + nu) / E
    np.testing.assert_allclose(spectrum, np.tile([boussinesq, drawn, boussinesq, across], (2, 1)), rtol=1e-7)


def test_loads_and_displacements_are_reciprocal() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(2, 16, 12, 3))
    work = np.sum(first * traction_response(SOFT, second, spacing_mm=0.7))
    reverse_work = np.sum(second * traction_response(SOFT, first, spacing_mm=0.7))
    assert work == pytest.approx(reverse_work, rel=1e-10)


def test_pressing_an_almost_incompressible_slab_pushes_its_face_outward() -> None:
    """A half space would be drawn in: the bonded back makes the difference."""
    C = tent_compliance(SOFT, np.array([[4.0, 0.0]]), np.zeros((1, 2)), pitch_mm=1.0)
    assert -C[0, 0, 0, 2] > 0
    assert -C[0, 2, 0, 2] > 0


def test_tents_of_a_grid_add_up_to_an_even_traction() -> None:
    slab = GelSlab(thickness_mm=1.0, E_MPa=0.2, nu=0.48)
    line = np.arange(-10.0, 10.5, 0.5)
    nodes = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    C = tent_compliance(slab, np.array([[0.2, 0.1]]), nodes, pitch_mm=0.5)
    moved = C[0].sum(axis=1) @ [0.0, 0.0, 0.05 * 0.5**2]
    assert moved[2] == pytest.approx(0.05 * 1.48 * 0.04 / (0.2 * 0.52), rel=0.01)


def test_the_slab_agrees_with_finite_elements_of_a_block_with_free_sides() -> None:
    """A smooth bump of traction, 1.5 mm in radius, on 14 x 14 x 2 mm of gel: within 3 % of the peak."""
    sides = [-7, -4.2, -2.8, -2.1, -1.4, -0.7, 0, 0.7, 1.4, 2.1, 2.8, 4.2, 7]
    block = gel_block(
        thickness_mm=2.0, E_MPa=0.2, nu=0.48, reach_mm=1.9, x_mm=sides, y_mm=sides, depths=(0, 0.4, 1)
    )
    r = np.linalg.norm(block.face_mm, axis=1)
    bump = np.where(r < 1.9, (1 - np.minimum(r / 1.9, 1) ** 2) ** 2, 0.0) * 0.05
    spacing, n = 0.175, 192
    axis = spacing * np.fft.fftfreq(n, 1 / n)
    R = np.hypot(axis[:, None], axis)
    slab = GelSlab(thickness_mm=2.0, E_MPa=0.2, nu=0.48)
    near = np.flatnonzero(r < 3.1)
    at = np.rint(block.face_mm[near] / spacing).astype(int)
    for component in (0, 2):
        nodal = np.zeros((len(r), 3))
        nodal[:, component] = bump * block.weights_mm2
        by_elements = (block.compliance @ nodal[block.reach].ravel()).reshape(-1, 3)[near]
        load = np.zeros((n, n, 3))
        load[..., component] = np.where(R < 1.9, (1 - np.minimum(R / 1.9, 1) ** 2) ** 2, 0.0) * 0.05
        by_slab = traction_response(slab, load, spacing_mm=spacing)[at[:, 0], at[:, 1]]
        by_slab *= nodal[:, component].sum() / (load[..., component].sum() * spacing**2)
        peak = np.abs(by_elements).max()
        np.testing.assert_allclose(by_slab, by_elements, atol=0.03 * peak)


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


@pytest.mark.parametrize("sides", ["free", "bonded"])
@pytest.mark.parametrize("way", [0, 2])
def test_a_gel_with_sides_moves_as_another_librarys_elements_say(way: int, sides: GelSides) -> None:
    *truth, under_load = by_elements(bonded=sides == "bonded")[way]
    misses = {}
    for outline in (GelOutline(SIZE_MM, sides=sides), None):
        slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, outline=outline)
        response = tent_compliance(slab, AT_MM, LOADED_MM, pitch_mm=PITCH_MM)[..., way].sum(axis=2)
        misses[outline] = np.abs(response - truth).max() / np.abs(under_load).max()
    with_sides, endless = misses.values()
    assert with_sides < 0.01
    assert endless > 5 * with_sides


@pytest.mark.proof
@pytest.mark.parametrize("way", [0, 2])
def test_a_domed_gel_moves_as_another_librarys_elements_say(way: int) -> None:
    *truth, under_load = by_elements(bonded=False, domed=True)[way]
    misses = {}
    for radius in (DOME, (np.inf, np.inf)):
        outline = GelOutline(SIZE_MM, face_radius_mm=radius)
        slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, outline=outline)
        response = tent_compliance(slab, AT_MM, LOADED_MM, pitch_mm=PITCH_MM)[..., way].sum(axis=2)
        misses[radius] = np.abs(response - truth).max() / np.abs(under_load).max()
    assert misses[DOME] < 0.004
    assert misses[np.inf, np.inf] > 5 * misses[DOME]


def test_markers_of_a_domed_gel_lie_on_its_face(tmp_path) -> None:
    path = tmp_path / "sensor.toml"
    dome = "size_mm = [26, 22]\nface_radius_mm = [190, 114]\n"
    path.write_text(GEL + dome + "[markers]\nrows = 3\ncolumns = 3\npitch_mm = [8, 6]\n")
    rest = read_sensor(path).rest_mm
    assert rest[4].tolist() == [0, 0, 0]
    assert rest[0, 2] == pytest.approx(-(8**2) / (2 * 190) - 6**2 / (2 * 114))


def test_far_sides_change_nothing() -> None:
    wide = side_response(THICKNESS_MM, NU, GelOutline((40.0, 40.0)))
    change = wide.between(np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0) / E_MPA
    slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU)
    compliance = tent_compliance(slab, np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0)
    assert np.abs(change).max() < 1e-3 * np.abs(compliance).max()


GEL = 'kind = "fields"\nname = "a gel"\n[gel]\nthickness_mm = 4.0\nE_MPa = 0.2\nnu = 0.48\n'


def test_a_description_says_where_the_gel_ends(tmp_path) -> None:
    path = tmp_path / "sensor.toml"
    path.write_text(GEL + 'size_mm = [26, 22]\ncentre_mm = [0.5, 0]\nsides = "bonded"\n')
    assert read_sensor(path).outline == GelOutline((26.0, 22.0), (0.5, 0.0), "bonded")
    path.write_text(GEL)
    assert read_sensor(path).outline is None


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("size_mm = [26, 0.2]", "size_mm: found [26.0, 0.2]"),
        ("size_mm = [26]", "size_mm"),
        ('sides = "free"', "size_mm: found none"),
        ("centre_mm = [0, 0]", "size_mm: found none"),
        ('size_mm = [26, 22]\nsides = "glued"', "sides"),
        ("face_radius_mm = [190, 114]", "size_mm: found none"),
        ("size_mm = [26, 22]\nface_radius_mm = [10, 114]", "face_radius_mm: found [10.0, 114.0]"),
        ("size_mm = [26, 22]\nface_radius_mm = [26, 26]", "expected corners at most 60%"),
    ],
)
def test_an_outline_that_cannot_be_is_refused(tmp_path, lines: str, words: str) -> None:
    path = tmp_path / "sensor.toml"
    path.write_text(GEL + lines + "\n")
    with pytest.raises(TactileFailure) as refusal:
        read_sensor(path)
    assert words in str(refusal.value)
