"""A gel that ends: its sides against finite elements of another library, and how a description says them."""

from functools import lru_cache

import numpy as np
import pytest
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

from tactile.gel.gel_sides import GelOutline, GelSides, side_response
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.io.sensor_file import read_sensor
from tactile.tactile_failure import TactileFailure

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
    found = {}
    for outline in (GelOutline(SIZE_MM, sides=sides), None):
        slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, outline=outline)
        response = tent_compliance(slab, AT_MM, LOADED_MM, pitch_mm=PITCH_MM)[..., way].sum(axis=2)
        found[outline] = np.abs(response - truth).max() / np.abs(under_load).max()
    with_sides, endless = found.values()
    assert with_sides < 0.01
    assert endless > 5 * with_sides


@pytest.mark.proof
@pytest.mark.parametrize("way", [0, 2])
def test_a_domed_gel_moves_as_another_librarys_elements_say(way: int) -> None:
    *truth, under_load = by_elements(bonded=False, domed=True)[way]
    found = {}
    for radius in (DOME, (np.inf, np.inf)):
        outline = GelOutline(SIZE_MM, face_radius_mm=radius)
        slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, outline=outline)
        response = tent_compliance(slab, AT_MM, LOADED_MM, pitch_mm=PITCH_MM)[..., way].sum(axis=2)
        found[radius] = np.abs(response - truth).max() / np.abs(under_load).max()
    assert found[DOME] < 0.004
    assert found[np.inf, np.inf] > 5 * found[DOME]


def test_a_face_with_huge_radii_is_the_flat_one() -> None:
    flat, nearly = (side_response(THICKNESS_MM, NU, GelOutline(SIZE_MM, face_radius_mm=r)).difference
                    for r in ((np.inf, np.inf), (1e9, 1e9)))  # fmt: skip
    assert np.abs(nearly - flat).max() < 1e-6 * np.abs(flat).max()


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
    own = tent_compliance(slab, np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0)
    assert np.abs(change).max() < 1e-3 * np.abs(own).max()


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
