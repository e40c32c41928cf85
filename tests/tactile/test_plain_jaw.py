"""A plain jaw opposite a gel: where it touches, how widely, and with what force."""

from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import ball, gel_pad, held_by

from tactile.plain_jaw import has_plain_jaw, with_plain_jaw
from tactile.readers.recording import GelPad, IndenterPad, Recording
from tactile.tactile_failure import TactileFailure

RADIUS_MM = 30.0
FRAMES = 9
CLOSED_MM = 2.0
SKIN = ball(RADIUS_MM, 20_000)


def pose_at(side: float, closed_mm: float) -> np.ndarray:
    """A jaw on the x axis whose z points to the ball's centre, and whose origin is 3 mm beside the axis."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, 0, -side], [1, 0, 0], [0, -side, 0]])
    pose[:3, 3] = [side * (RADIUS_MM - closed_mm / 2), 3.0, 0.0]
    return pose


def grasp(*, shear_N: float = 0.0) -> Recording:
    """Jaws close by CLOSED_MM after a frame in the air; a gel on the left gives 0.4 mm under 5 N at the
    end."""
    share = np.r_[0.0, np.linspace(0, 1, FRAMES - 1)]
    line = np.arange(-5.0, 6.0)
    rest = np.column_stack([*(axis.ravel() for axis in np.meshgrid(line, line)), np.zeros(121)])
    pressed = np.linalg.norm(rest, axis=1) < 3.1
    weight = pressed / pressed.sum()
    force = share[:, None, None] * weight[:, None] * np.array([shear_N, 0.0, 5.0])
    moved = share[:, None, None] * pressed[:, None] * np.array([0.0, 0.0, -0.4])
    left = gel_pad("left", rest, moved, force, pose=np.stack([pose_at(-1.0, CLOSED_MM * s) for s in share]))
    right = IndenterPad(
        name="right",
        pose=np.stack([pose_at(1.0, CLOSED_MM * s) for s in share]),
        force_z_N=5.0 * share,
        indenter="plate",
        radius_mm=None,
    )
    return held_by((left, right), np.arange(float(FRAMES)), 2 * RADIUS_MM - CLOSED_MM * share)


def jaw_of(recording: Recording) -> GelPad:
    return with_plain_jaw(recording, SKIN, source="g.h5").pads[1]


def test_the_jaw_pushes_back_what_the_gel_pushes() -> None:
    recording = grasp(shear_N=0.7)
    left, right = recording.pads[0], jaw_of(recording)
    on_fruit = [np.einsum("tij,tnj->ti", pad.pose[:, :3, :3], pad.force_N) for pad in (left, right)]
    assert np.abs(on_fruit[0] + on_fruit[1]).max() < 1e-12
    assert not right.displacement_mm.any()


def test_it_touches_where_the_fruit_comes_first_and_as_widely_as_hertz_has_it() -> None:
    right = jaw_of(grasp())
    weight = right.force_N[-1, :, 2]
    middle = weight @ right.rest_mm / weight.sum()
    # the jaw's origin is 3 mm along its own x beside the ball's middle
    assert middle[:2] == pytest.approx([-3.0, 0.0], abs=0.1)
    radius = np.linalg.norm(right.rest_mm[:, :2] - middle[:2], axis=1)
    contact = float(radius[weight > 0].max())
    gel_mm = np.sqrt(29 / np.pi)
    indentation_mm = CLOSED_MM - 0.4
    expected = next(
        a for a in np.arange(0.1, 20, 0.001) if a**2 >= RADIUS_MM * indentation_mm / (1 + a / gel_mm)
    )
    assert contact == pytest.approx(expected, rel=0.15)
    # Hertz's pressure has a mean square radius of 2/5 of the contact's
    assert np.sqrt(weight @ radius**2 / weight.sum()) == pytest.approx(np.sqrt(0.4) * expected, rel=0.03)


def test_where_the_flesh_is_known_the_contact_is_as_wide_as_hertz_has_it_of_the_force() -> None:
    """Johnson 1985, eq. 4.22: a^3 = 3 F R / (4 E*), in every frame."""
    plane_strain_MPa = 0.8
    right = with_plain_jaw(grasp(), SKIN, source="g.h5", plane_strain_MPa=plane_strain_MPa).pads[1]
    for frame in (FRAMES // 2, FRAMES - 1):
        weight = right.force_N[frame, :, 2]
        middle = weight @ right.rest_mm / weight.sum()
        radius = np.linalg.norm(right.rest_mm - middle, axis=1)
        hertz = np.cbrt(0.75 * weight.sum() * RADIUS_MM / plane_strain_MPa)
        assert np.sqrt(weight @ radius**2 / weight.sum()) == pytest.approx(np.sqrt(0.4) * hertz, rel=0.03)


def test_only_a_gel_and_a_plate_make_such_a_grasp() -> None:
    recording = grasp()
    assert has_plain_jaw(recording)
    two = replace(recording, pads=(recording.pads[0], replace(recording.pads[0], name="right")))
    assert not has_plain_jaw(two)
    assert with_plain_jaw(two, SKIN, source="g.h5") is two
    assert not has_plain_jaw(replace(recording, loading="press"))


def test_a_jaw_that_faces_away_is_refused() -> None:
    recording = grasp()
    right = recording.pads[1]
    away = right.pose.copy()
    away[:, :3, 1:3] *= -1
    turned = replace(recording, pads=(recording.pads[0], replace(right, pose=away)))
    with pytest.raises(
        TactileFailure, match=r"g\.h5: pads/right: found a plain jaw without round skin in front of it"
    ):
        with_plain_jaw(turned, SKIN, source="g.h5")
