import numpy as np
import pytest
from compressed_solid import cylinder, linear

from fem.fem_failure import FemFailure
from fem.indentation.compressed_cylinder import Cylinder

SLIDING = np.array([0.1, 0.2, 0.3])
IN_TABLE = np.array([0.01, 0.07, 0.13, 0.2])
BEYOND = np.arange(0.04, 0.45, 0.04)
"""Strains up to 44 %, where the coarse mesh stops; a finer one stops earlier."""


def force(strain, *, ends, nu, height=1.0, diameter=1.0):
    curve = Cylinder(diameter_mm=diameter, height_mm=height, ends=ends).curve(
        thickness_mm=None, poisson_ratio=nu
    )
    return curve.force_N_per_MPa(np.array(strain * height))


def test_sliding_ends_are_youngs_modulus_at_small_strain():
    area = np.pi * 4.0**2 / 4
    assert force(1e-4, ends="lubricated", nu=0.45, diameter=4.0) == pytest.approx(area * 1e-4, rel=1e-3)


def test_incompressible_sliding_ends_are_the_neo_hookean_closed_form():
    """Treloar's (1/l^2 - l)/3."""
    strain = np.array([0.05, 0.1, 0.2, 0.3])
    left = 1 - strain
    stress = force(strain, ends="lubricated", nu=0.4999) / (np.pi / 4)
    assert stress == pytest.approx((left**-2 - left) / 3, rel=1e-3)


@pytest.mark.parametrize("slender", [0.1, 0.125, 0.2])
def test_thin_bonded_discs_follow_gent_and_lindley(slender):
    """1/Ea = 1/(E (1 + 2 S^2)) + 1/K, S = D/(4 H); of the finite elements, which reach thinner."""
    nu = 0.495
    solid = cylinder(nu=nu, radius=0.5, height=slender, bonded=True, across=24, up=10, law=linear)
    apparent = solid.force_at(slender / 2 * 0.999) / (np.pi / 4 * 0.001)
    shape = 1 / (4 * slender)
    bulk = 1 / (3 * (1 - 2 * nu))
    assert apparent == pytest.approx(1 / (1 / (1 + 2 * shape**2) + 1 / bulk), rel=0.12)


@pytest.mark.parametrize(
    ("ends", "nu", "slender", "mesh", "strain", "rel"),
    [
        ("lubricated", 0.4, 1.0, (3, 3), SLIDING, 1e-4),
        ("bonded", 0.35, 0.8, (20, 14), IN_TABLE, 0.01),
        pytest.param("bonded", 0.43, 0.27, (20, 14), IN_TABLE, 0.01, marks=pytest.mark.proof),
        ("bonded", 0.47, 1.2, (20, 14), IN_TABLE, 0.01),
        pytest.param("bonded", 0.49, 0.6, (20, 14), IN_TABLE, 0.01, marks=pytest.mark.proof),
        ("bonded", 0.49, 0.6, (8, 6), BEYOND, 0.05),
    ],
)
def test_curves_agree_with_finite_elements(ends, nu, slender, mesh, strain, rel):
    """On other meshes and shapes than the table's."""
    across, up = mesh
    bonded = ends == "bonded"
    solid = cylinder(nu=nu, radius=0.5, height=slender, bonded=bonded, across=across, up=up)
    truth = [solid.force_at(slender / 2 * (1 - e)) for e in strain]
    assert force(strain, ends=ends, nu=nu, height=slender) == pytest.approx(truth, rel=rel)


def test_tall_specimens_do_not_know_their_ends():
    bonded, sliding = (force(0.05, ends=e, nu=0.45, height=3.0) for e in ("bonded", "lubricated"))
    assert bonded / sliding == pytest.approx(1.04, abs=0.03)


def test_what_the_table_does_not_hold_is_refused():
    with pytest.raises(FemFailure, match=r"height 0\.1 diameters, expected 0\.25 to 3"):
        force(0.1, ends="bonded", nu=0.45, height=0.1)
    with pytest.raises(FemFailure, match=r"Poisson's ratio 0\.499 of a bonded"):
        force(0.1, ends="bonded", nu=0.499)
    with pytest.raises(FemFailure, match="thickness 5 mm of a specimen between plates"):
        Cylinder(diameter_mm=1.0, height_mm=1.0, ends="bonded").curve(thickness_mm=5.0, poisson_ratio=0.4)
    with pytest.raises(FemFailure, match="height 0 mm"):
        Cylinder(diameter_mm=1.0, height_mm=0.0, ends="bonded")


def test_sides_that_fold_onto_the_plates_make_held_ends_stiffer_again():
    """Once the sides touch, the ratio to sliding ends grows; without contact it falls towards 1."""
    strain = np.array([0.1, 0.3, 0.45, 0.6])
    folded, through = (
        cylinder(nu=0.45, radius=0.5, height=0.6, bonded=True, across=4, up=4, sides_touch=touch)
        for touch in (True, False)
    )
    sliding = force(strain, ends="lubricated", nu=0.45, height=0.6)
    ratio = np.array([folded.force_at(0.3 * (1 - e)) for e in strain]) / sliding
    assert ratio[0] == pytest.approx(through.force_at(0.3 * 0.9) / sliding[0], rel=1e-9)
    assert ratio[1] < ratio[0]
    assert ratio[3] > ratio[2] + 0.02
