"""A rig's compliance and a gel's modulus from squeezes by closed forms."""

import numpy as np
import pytest
from injected_grasp import gel_pad
from series_springs import SeriesRig, bare_press, press

from tactile.gel.press_modulus import gel_gain
from tactile.rig.rig_curve import MOST_BEYOND, RigCurve, without_rig
from tactile.rig.rig_fit import FittedRig, fit_rig
from tactile.rig.rigid_squeeze import gel_give_mm, rigid_squeezes
from tactile.tactile_failure import TactileFailure

RIG = SeriesRig()


def squeezes_in(columns, *, size_mm=40.0):
    _, force, travel = columns
    return rigid_squeezes(force, travel, part_mm=None, size_mm=size_mm, source="s.csv")


def fitted(rng, *, scales=(1.0, 1.0, 1.0), rig=RIG, **how) -> FittedRig:
    return fit_rig([squeeze for s in scales for squeeze in squeezes_in(press(rng, rig, scale=s, **how))])


@pytest.mark.parametrize(
    "rig", [RIG, SeriesRig(spring_N_per_mm=3.0, pads=1e9), SeriesRig(spring_N_per_mm=1e9, pads=5.0)]
)
def test_spring_and_hertz_in_series_come_back(rig):
    curve = fitted(np.random.default_rng(1), rig=rig).curve
    force = np.linspace(0, curve.largest_N, 200)
    truth = rig.give_mm(force)
    assert np.abs(curve.give(force) - truth).max() < 0.01 * truth[-1]
    assert (np.diff(curve.give(force)) >= 0).all()


def test_the_written_knots_lose_a_thousandth_of_the_give_at_most():
    force = 20.0 * (np.arange(49) / 48) ** 1.5
    curve = RigCurve(force_N=force, give_mm=RIG.give_mm(force), sd_mm=0.01 * force)
    at = np.linspace(0, 20, 4001)
    assert np.abs(curve.give(at) - RIG.give_mm(at)).max() < 1e-3 * RIG.give_mm(20.0)


@pytest.mark.parametrize("squeezes", [2, 4, 8])
def test_the_spread_covers_the_next_squeeze(squeezes):
    rng = np.random.default_rng(2)
    off = []
    for _ in range(100):
        scales = 1 + 0.08 * rng.standard_normal(squeezes + 1)
        curve = fitted(rng, scales=scales[:squeezes], back=False).curve
        truth = scales[squeezes] * RIG.give_mm(curve.force_N[-1])
        off.append((curve.give_mm[-1] - truth) / curve.sd_mm[-1])
    assert 0.5 < np.std(off) < 1.3
    assert 0.83 < np.mean(np.abs(off) < 1.645) < 0.99


def test_one_squeeze_has_the_usual_spread_and_many_their_own():
    rng = np.random.default_rng(3)
    single = fitted(rng, scales=(1.0,))
    assert single.repeat_mm == pytest.approx(
        0.05 * np.sqrt(2) * 2.920 / 1.645 * single.curve.give_mm[-1], rel=1e-3
    )
    assert fitted(rng, scales=(1.0,) * 12).repeat_mm < 0.3 * single.repeat_mm


def test_friction_between_the_ways_is_said_and_is_in_the_spread():
    rng = np.random.default_rng(4)
    free, rubbing = fitted(rng), fitted(rng, friction_mm=0.4)
    assert abs(free.hysteresis_mm) < 0.02
    assert rubbing.hysteresis_mm == pytest.approx(0.2, abs=0.03)
    middle = len(rubbing.curve.force_N) // 2
    assert rubbing.curve.sd_mm[middle] > free.curve.sd_mm[middle] + 0.05


def test_beyond_the_calibrated_force_the_spread_covers_what_stiffens_and_what_does_not():
    curve = fitted(np.random.default_rng(5)).curve
    beyond = MOST_BEYOND * curve.largest_N
    give, sd = float(curve.give(np.array(beyond))), float(curve.sd(np.array(beyond)))
    assert abs(give - RIG.give_mm(beyond)) < sd
    assert abs(give - RIG.give_mm(curve.largest_N)) < 2.1 * sd
    assert sd > curve.sd_mm[-1]
    assert curve.reaches(beyond * 0.999)
    assert not curve.reaches(beyond * 1.001)


def yielding(force):
    return 0.02 * force**2


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"relaxes": 0.4, "hold": 200}, "of the force lost while the travel stands still"),
        ({"peak_N": 0.1}, "a largest force of"),
        ({"frames": 3, "back": False}, "readings of the travel on the way to"),
        ({"own_mm": yielding}, "over the upper half of the force"),
        ({"own_mm": lambda force: force}, "of travel on an object of 40 mm"),
    ],
)
def test_what_is_no_rigid_squeeze_is_refused(how, said):
    with pytest.raises(TactileFailure, match="no squeeze of a rigid object") as failure:
        squeezes_in(press(np.random.default_rng(6), RIG, **how))
    assert said in str(failure.value)
    assert "expected" in str(failure.value)


def test_force_that_breaks_off_and_travel_that_stays_are_refused():
    time, force, travel = press(np.random.default_rng(7), RIG)
    broken = np.where((np.arange(len(force)) > 60) & (np.arange(len(force)) < 70), 0.5 * force, force)
    with pytest.raises(TactileFailure, match="while the travel goes on"):
        squeezes_in((time, broken, travel))
    with pytest.raises(TactileFailure, match=r"of travel as|a travel that goes|readings of the travel"):
        squeezes_in((time, force, np.zeros(len(force))))
    top = int(np.argmax(force))
    dented = np.where(np.arange(len(force)) > top, travel[top] - 0.3 * (travel[top] - travel), travel)
    with pytest.raises(TactileFailure, match="of the travel left as the force comes back"):
        squeezes_in((time, force, dented))


def test_a_travel_that_does_not_resolve_the_rig_is_refused():
    stiff = SeriesRig(spring_N_per_mm=20000.0, pads=1e9)
    with pytest.raises(TactileFailure, match="mm off one curve"):
        fitted(np.random.default_rng(8), rig=stiff, noise_mm=0.002)


def test_two_squeezes_in_one_recording_are_two():
    first = press(np.random.default_rng(9), RIG)
    second = press(np.random.default_rng(10), RIG)
    time = np.arange(len(first[0]) + len(second[0])) / 20.0
    assert len(squeezes_in((time, np.r_[first[1], second[1]], np.r_[first[2], second[2]]))) == 2


def object_mm(force):
    """Hertz: a ball of 5 mm on a half-space of 1 MPa, nu 0.45."""
    return (np.maximum(force, 0) / (4 / 3 / (1 - 0.45**2) * np.sqrt(5.0))) ** (2 / 3)


def test_what_is_left_of_the_travel_is_the_objects():
    rng = np.random.default_rng(11)
    curve = fitted(rng).curve
    columns = press(rng, RIG, own_mm=object_mm, peak_N=15.0, noise_mm=0.0, noise_N=0.0, zero_N=0.3)
    left = without_rig(bare_press(*columns), curve, source="t.csv", named="rig.toml").recording
    force = columns[1] - 0.3
    loaded = force > 0.5
    off = left.aperture_mm - 0.4 - object_mm(force)
    assert np.ptp(off[loaded]) < 0.005 * RIG.give_mm(15.0)
    assert (np.abs(off - off[loaded].mean()) < left.rig_sd_mm)[loaded].all()


def test_a_trace_beyond_the_rig_or_corrected_before_is_refused():
    rng = np.random.default_rng(12)
    curve = fitted(rng).curve
    with pytest.raises(TactileFailure, match=r"calibrated up to 20 N.*at most 1.25 times that"):
        without_rig(bare_press(*press(rng, RIG, peak_N=30.0)), curve, source="t.csv", named="rig.toml")
    said = without_rig(bare_press(*press(rng, RIG, peak_N=23.0)), curve, source="t.csv", named="rig.toml")
    assert any("extrapolated by its last slope" in note for note in said.notes)
    with pytest.raises(TactileFailure, match="already corrected for a rig"):
        without_rig(said.recording, curve, source="t.csv", named="rig.toml")


def gel_under_a_ball(depth_mm, *, radius_mm, centre=(0.7, -0.4)):
    """A gel whose markers stand on the ball wherever it reaches: exact sphere, nothing else moves."""
    x, y = np.meshgrid(np.arange(-8, 8.1, 1.0), np.arange(-6, 6.1, 1.0))
    rest = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    r2 = (rest[:, 0] - centre[0]) ** 2 + (rest[:, 1] - centre[1]) ** 2
    lower = radius_mm - np.sqrt(np.maximum(radius_mm**2 - r2, 0.0))
    moved = np.zeros((len(depth_mm), len(rest), 3))
    moved[:, :, 2] = -np.maximum(np.asarray(depth_mm)[:, None] - lower, 0.0)
    return gel_pad("left", rest, moved, np.zeros_like(moved))


def test_a_gel_under_a_ball_is_as_deep_as_the_ball_between_its_markers():
    depth = np.array([0.0, 0.2, 0.5, 1.0])
    given = gel_give_mm(gel_under_a_ball(depth, radius_mm=20.0), shape="ball", size_mm=40.0)
    np.testing.assert_allclose(given, depth, atol=3e-3)
    flat = gel_under_a_ball(depth, radius_mm=1e6)
    np.testing.assert_allclose(gel_give_mm(flat, shape="block", size_mm=30.0), depth, atol=1e-3)


PRESS = np.concatenate([np.zeros(5), np.linspace(0, 4, 20), np.full(5, 4.0), np.linspace(4, 0, 10)])


def test_the_gain_is_load_cell_over_gel_whatever_the_signs() -> None:
    assert gel_gain(-1.3 * PRESS, PRESS, source="p").value == pytest.approx(1.3)


def test_the_stated_deviation_is_that_of_repeated_presses() -> None:
    rng = np.random.default_rng(0)
    gains = [gel_gain(1.3 * PRESS + rng.normal(scale=0.05, size=40), PRESS, source="p") for _ in range(400)]
    assert np.std([g.value for g in gains]) == pytest.approx(np.mean([g.sd for g in gains]), rel=0.15)


def test_too_short_a_press_is_refused() -> None:
    with pytest.raises(
        TactileFailure, match="flat: found 3 frames in which gel and load cell measure the press"
    ):
        gel_gain(np.array([0, 1.0, 1, 1, 0]), np.array([0, 1.0, 1, 1, 0]), source="flat")


def test_a_load_cell_that_felt_something_else_is_refused() -> None:
    with pytest.raises(
        TactileFailure, match="one line through zero; check that the whole contact is in view"
    ):
        gel_gain(np.roll(PRESS, 8), PRESS, source="flat")
