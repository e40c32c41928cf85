"""The course of a contact: its patch by the closed form, its stick ratio, and a shipped recording's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactile.contact import find_contact
from tactile.contact_course import contact_course, patch_area_mm2, said, stick_ratio
from tactile.io.recording import read_recording

GRASP = (
    Path(__file__).parents[2] / "samples" / "data" / "nectarines" / "fruits" / "N01" / "grasps" / "grasp-1.h5"
)
X, Y = (axis.ravel() for axis in np.meshgrid(np.arange(20.0) - 9.5, np.arange(20.0) - 9.5))
REST = np.stack([X, Y, np.zeros(400)], axis=1)
NOISE = 0.005
PATCH = np.column_stack([(near := REST[np.abs(REST).max(axis=1) < 5])[:, :2], 0.02 * (near**2).sum(axis=1)])
RIM = np.linalg.norm(PATCH[:, :2], axis=1) > 4.6
ALWAYS = np.ones((20, 100), dtype=bool)


def disc(radius_mm: float, centre: tuple[float, float] = (0.3, -0.2)) -> np.ndarray:
    return np.asarray(np.hypot(X - centre[0], Y - centre[1]) < radius_mm)


def test_a_discs_area_is_right_without_a_bias() -> None:
    rng = np.random.default_rng(8)
    radii, centres = rng.uniform(3, 7, 60), rng.uniform(-1, 1, (60, 2))
    areas = [patch_area_mm2(REST, disc(r, (x, y))) for r, (x, y) in zip(radii, centres, strict=True)]
    error_mm = np.sqrt(np.array(areas) / np.pi) - radii
    assert np.abs(error_mm).max() < 0.25
    assert abs(error_mm.mean()) < 0.03


def test_a_straight_border_is_exact_and_two_patches_add_up() -> None:
    assert patch_area_mm2(REST, X > 1.0) == pytest.approx(19 * 8.5, rel=1e-12)
    left, right = disc(3.0, (-5.0, 0.1)), disc(3.0, (5.0, 0.1))
    alone = patch_area_mm2(REST, left) + patch_area_mm2(REST, right)
    assert patch_area_mm2(REST, left | right) == pytest.approx(alone, rel=1e-12)
    assert patch_area_mm2(REST, np.zeros(400, dtype=bool)) == 0.0


def moved(slips: np.ndarray, *, lags: float, dims: int) -> np.ndarray:
    """The patch turns by 0.6 degrees and shifts a frame; slipping markers make 1 - `lags` of it."""
    where, a = [PATCH], 0.01
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    for _ in range(19):
        step = where[-1] @ turn.T + [0.12, 0.05, 0.0] - where[-1]
        where.append(where[-1] + step * np.where(slips, 1 - lags, 1.0)[:, None])
    noise = np.random.default_rng(5).normal(scale=NOISE, size=(20, 100, 3))
    return (np.stack(where) + noise)[..., :dims]


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("slips", [np.zeros(100, bool), RIM])
def test_a_body_that_turns_and_shifts_sticks_but_for_the_rim_that_stays_behind(slips, dims: int) -> None:
    found = stick_ratio(moved(slips, lags=0.8, dims=dims), ALWAYS, noise=NOISE, lag=3)
    np.testing.assert_allclose(found[3:], 1 - slips.mean(), atol=0.04 if slips.any() else 0.02)


def test_a_body_at_rest_sticks_no_contact_has_no_stick_and_lost_markers_do_not_slip() -> None:
    still = PATCH + np.random.default_rng(2).normal(scale=NOISE, size=(12, 100, 3))
    found = stick_ratio(still, np.arange(12)[:, None] < np.full(100, 8), noise=NOISE, lag=3)
    assert found[:8].min() > 0.97
    np.testing.assert_array_equal(found[8:], 0.0)
    where = moved(np.zeros(100, bool), lags=0, dims=2)
    where[6:9, 40:50] = np.nan
    assert stick_ratio(where, ALWAYS, noise=NOISE, lag=3).min() > 0.98


@pytest.fixture(scope="module")
def contact():
    return find_contact(read_recording(GRASP), source=GRASP.name)


def test_every_pad_touches_once_and_the_patch_follows_the_force(contact):
    courses = contact_course(contact)
    assert [course.pad for course in courses] == [pad.name for pad in contact.pads]
    for course in courses:
        at = np.flatnonzero(course.touches)
        assert 0 < at[0] < at[-1] < len(contact.time_s) - 1
        assert not course.patch_mm2[~course.touches].any()
        assert np.corrcoef(course.normal_N[at], course.patch_mm2[at])[0, 1] > 0.9
        assert np.abs(course.patch_mm2.argmax() - course.normal_N.argmax()) <= 0.2 * len(at)


def test_a_pad_that_slides_along_the_fruit_is_said_to_slip(contact):
    pad = contact.pads[0]
    held = contact_course(contact)[0]
    slid = pad.position_mm.copy()
    some = np.arange(slid.shape[1]) % 4 == 0
    steps = np.arange(len(slid), dtype=float)[:, None]
    slid[:, some] += 0.1 * steps[..., None] * np.array([1.0, 0.0, 0.0])
    pads = (replace(pad, position_mm=slid), contact.pads[1])
    slipping = contact_course(replace(contact, pads=pads))[0]
    fullest = held.patch_mm2.argmax()
    assert held.stick_ratio[fullest] > 0.9
    assert slipping.stick_ratio[fullest] == pytest.approx(0.75, abs=0.08)


def test_the_line_for_people_names_times_force_patch_and_slip(contact):
    course = contact_course(contact)[1]
    ratio = course.stick_ratio.copy()
    hardest = course.normal_N.argmax()
    ratio[hardest] = 0.62
    line = said(replace(course, stick_ratio=ratio), contact.time_s)
    assert line.startswith(f"{course.pad}: contact from ")
    force, patch = course.normal_N.max(), course.patch_mm2[hardest]
    assert f"up to {force:.2f} N on {patch:.0f} mm², where 62 % of the contact sticks" in line
