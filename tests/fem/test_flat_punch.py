import numpy as np
import pytest
from compressed_solid import Plastic, neo_hookean, pressed_slab, punched_slab

from fem.fem_failure import FemFailure
from fem.indentation.effects.trace_plastic_set import plastic_slack_mm
from fem.indentation.flat_punch import FlatPunch, slab_factor_of_punch


def per_mm(thickness_mm, nu, radius_mm=1.0):
    curve = FlatPunch(radius_mm=radius_mm).curve(thickness_mm=thickness_mm, poisson_ratio=nu)
    return float(curve.force_N_per_MPa(np.array(1.0)))


def test_on_a_thick_slab_it_is_boussinesqs():
    assert per_mm(None, 0.3, radius_mm=2.0) == pytest.approx(2 * 2.0 / (1 - 0.3**2))
    assert per_mm(1e4, 0.3, radius_mm=2.0) == pytest.approx(2 * 2.0 / (1 - 0.3**2), rel=1e-3)


def test_force_is_linear_in_depth_and_nothing_in_the_air():
    curve = FlatPunch(radius_mm=3.0).curve(thickness_mm=6.0, poisson_ratio=0.45)
    tenth, four = curve.force_N_per_MPa(np.array([0.1, 0.4]))
    assert four == pytest.approx(4 * tenth)
    assert curve.force_N_per_MPa(np.array(-1.0)) == 0


PUBLISHED = {
    0.30: (1.207, 1.472, 1.784, 2.124, 2.480, 3.400, 4.336),
    0.35: (1.218, 1.502, 1.839, 2.211, 2.603, 3.629, 4.685),
    0.40: (1.232, 1.542, 1.917, 2.337, 2.789, 3.996, 5.271),
    0.45: (1.252, 1.599, 2.031, 2.532, 3.085, 4.638, 6.380),
    0.50: (1.281, 1.683, 2.211, 2.855, 3.609, 5.970, 9.069),
}
"""Factor by Poisson's ratio at radius over thickness .2, .4, .6, .8, 1, 1.5 and 2: table 1 of Hayes et al.
1972, whose quadrature errs by up to a hundredth where the slab is thin."""


@pytest.mark.parametrize("nu", PUBLISHED)
def test_slabs_agree_with_the_published_table_within_its_last_digits(nu):
    over = np.array([0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0])
    factors = np.array(
        [slab_factor_of_punch(radius_over_thickness, poisson_ratio=nu) for radius_over_thickness in over]
    )
    assert factors[:3] == pytest.approx(PUBLISHED[nu][:3], rel=0.001)
    assert factors == pytest.approx(PUBLISHED[nu], rel=0.01)


@pytest.mark.proof
def test_finite_strain_moves_the_force_by_a_fiftieth_at_most_in_the_trusted_range():
    slab = punched_slab(nu=0.45, radius=1, thickness=2, wide=16, law=neo_hookean)
    force = [slab.force_at(2 - d) for d in (0.05, 0.1, 0.2)]
    assert per_mm(2.0, 0.45) * np.array([0.05, 0.1, 0.2]) == pytest.approx(force, rel=0.02)


def test_a_slab_too_thin_is_refused_with_the_way_out():
    with pytest.raises(FemFailure, match=r"radius 5 mm on 2 mm .* --specimen cylinder"):
        FlatPunch(radius_mm=5.0).curve(thickness_mm=2.0, poisson_ratio=0.45)
    with pytest.raises(FemFailure, match="radius -1 mm"):
        FlatPunch(radius_mm=-1.0)


def elastic_mm(curve, yield_MPa, deepest_mm):
    """What of these depths stays elastic, E = 1 MPa."""
    set_mm = plastic_slack_mm(
        {"yield_over_E": np.array([yield_MPa])}, curve, deepest_mm[None], np.zeros((1, 1))
    )
    return deepest_mm - set_mm[0, :, 0]


def test_flow_under_a_punch_follows_finite_elements_within_a_fiftieth():
    """Of the largest force; E = 1 MPa. The elements' own elastic force is taken out of the comparison."""
    depth, yield_MPa = np.array([0.04, 0.1, 0.2, 0.3, 0.4]), 0.05
    size = {"nu": 0.45, "thickness": 15.0, "wide": 60.0, "contact": 2.0 / 1.6}
    flowing = pressed_slab(**size, law=Plastic(yield_MPa))
    plastic = np.array([flowing.force_at(15.0 - d) for d in depth])
    elastic = pressed_slab(**size).force_at(14.0) * depth
    curve = FlatPunch(radius_mm=2.0).curve(thickness_mm=15.0, poisson_ratio=0.45)
    share = curve.force_N_per_MPa(elastic_mm(curve, yield_MPa, depth)) / curve.force_N_per_MPa(depth)
    assert share * elastic == pytest.approx(plastic, abs=0.02 * plastic.max())


def test_flesh_that_flows_carries_shields_pressure():
    curve = FlatPunch(radius_mm=2.0).curve(thickness_mm=None, poisson_ratio=0.45)
    pressure = curve.force_N_per_MPa(elastic_mm(curve, 0.01, np.array([50.0])))[0] / (np.pi * 2.0**2)
    assert pressure / 0.01 == pytest.approx(5.69 / 2, rel=1e-3)
