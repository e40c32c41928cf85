"""The course of a contact, against a shipped recording whose pads close, hold and open again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactile.contact import find_contact
from tactile.contact_course import contact_course, said
from tactile.io.recording import read_recording

GRASP = (
    Path(__file__).parents[2] / "samples" / "data" / "nectarines" / "fruits" / "N01" / "grasps" / "grasp-1.h5"
)


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
