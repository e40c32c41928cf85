import numpy as np
import pytest
from compressed_solid import spheroid
from triaxial_fruit import force_between

from fem.fem_failure import FemFailure
from fem.indentation.compressed_ellipsoid import Ellipsoid
from fem.solid.closed_forms import hertz_sphere_force_N

SQUEEZES = np.array([0.02, 0.05, 0.1, 0.15, 0.2])


def curve(*diameters_mm, axis=2, pit_share=0.0, nu=0.45):
    fruit = Ellipsoid(diameters_mm=diameters_mm, axis=axis, pit_share=pit_share)
    return fruit.curve(thickness_mm=None, poisson_ratio=nu)


def test_a_slight_squeeze_of_a_sphere_is_hertz_at_both_contacts():
    hertz = hertz_sphere_force_N(E_MPa=1.0, poisson_ratio=0.45, radius_mm=30.0, indentation_mm=1e-5 / 2)
    assert curve(60.0, 60.0, 60.0).force_N_per_MPa(np.array(1e-5)) == pytest.approx(hertz, rel=2e-3)


@pytest.mark.parametrize(
    ("nu", "along", "pit_share"),
    [
        (0.47, 1.0, 0.42),
        (0.41, 0.88, 0.27),
        pytest.param(0.47, 1.12, 0.57, marks=pytest.mark.proof),
        (0.3, 1.4, 0.1),
    ],
)
def test_finite_elements_between_the_tables_shapes_agree_within_a_fiftieth(nu, along, pit_share):
    solid = spheroid(nu=nu, along=along, pit_share=pit_share, round_=20, out=9)
    truth = [solid.force_at(along * (1 - x)) for x in SQUEEZES]
    force = curve(2.0, 2.0, 2 * along, pit_share=pit_share, nu=nu).force_N_per_MPa(2 * along * SQUEEZES)
    assert force == pytest.approx(truth, rel=0.02)


@pytest.mark.proof
@pytest.mark.parametrize("semi_axes_mm", [(30.0, 29.0, 26.0), (30.0, 27.0, 30.0)])
def test_tetrahedra_of_a_fruit_without_an_axis_agree_within_a_thirtieth(semi_axes_mm):
    """The repository's own solver at small strain, for a squeeze of 3 %."""
    truth = force_between(semi_axes_mm, pit_share=0.4, nu=0.45, squeeze=0.03)
    a, b, c = 2 * np.array(semi_axes_mm)
    assert curve(a, b, c, pit_share=0.4).force_N_per_MPa(np.array(0.03 * c)) == pytest.approx(truth, rel=0.03)


def test_force_goes_with_the_square_of_size_at_one_squeeze():
    small, large = (curve(*(k * np.array([20.0, 22.0, 21.0])), pit_share=0.4) for k in (1, 3))
    ratio = large.force_N_per_MPa(3 * 21 * SQUEEZES) / small.force_N_per_MPa(21 * SQUEEZES)
    assert ratio == pytest.approx(9)


def test_which_two_diameters_lie_across_does_not_matter():
    first, second = curve(60.0, 56.0, 58.0), curve(58.0, 60.0, 56.0, axis=0)
    depth = 58 * SQUEEZES
    assert first.force_N_per_MPa(depth) == pytest.approx(second.force_N_per_MPa(depth))


def test_a_stone_makes_fruit_stiffer_the_deeper_the_more():
    over = curve(60.0, 60.0, 60.0, pit_share=0.5).over_half_space(60 * SQUEEZES)
    plain = curve(60.0, 60.0, 60.0).over_half_space(60 * SQUEEZES)
    assert (np.diff(over / plain) > 0).all()
    assert over[2] / plain[2] == pytest.approx(1.5, abs=0.1)


def test_shape_leaves_more_of_e_uncertain_the_larger_the_stone():
    fruits = [Ellipsoid(diameters_mm=(60.0,) * 3, axis=2, pit_share=share) for share in (0.0, 0.4, 0.6)]
    shares = [fruit.shape_sd(0.45) for fruit in fruits]
    assert shares == sorted(shares)
    assert shares[0] == pytest.approx(0.053, abs=1e-3)


def test_no_fruit_is_refused():
    with pytest.raises(FemFailure, match=r"90 x 60 x 40 mm, expected none more than 1\.6 times"):
        curve(90.0, 60.0, 40.0)
    with pytest.raises(FemFailure, match=r"a pit of 0\.8"):
        curve(60.0, 60.0, 60.0, pit_share=0.8)
    with pytest.raises(FemFailure, match="a fruit's is its diameter"):
        Ellipsoid(diameters_mm=(60.0, 60.0, 60.0), axis=0, pit_share=0.0).curve(
            thickness_mm=5.0, poisson_ratio=0.45
        )
