import numpy as np
import pytest

from samples.gel_press import BallPose, GelBlock, gel_block, pressed
from samples.sample_failure import NotInEquilibrium

SIDES = (-6, -3.5, -2.4, -1.6, -0.8, 0, 0.8, 1.6, 2.4, 3.5, 6)
RADIUS, FRICTION = 6.0, 0.4


@pytest.fixture(scope="module")
def block() -> GelBlock:
    return gel_block(
        thickness_mm=2.5, E_MPa=0.2, nu=0.4, reach_mm=2.3, x_mm=SIDES, y_mm=SIDES, depths=(0, 0.35, 1)
    )


def down(depth_mm: float) -> BallPose:
    return BallPose(centre_mm=(0.0, 0.0, RADIUS - depth_mm))


def test_loads_and_displacements_are_reciprocal(block: GelBlock) -> None:
    rows = (3 * block.reach[:, None] + np.arange(3)).ravel()
    small = block.compliance[rows]
    np.testing.assert_allclose(small, small.T, atol=1e-9 * np.abs(small).max())


def test_a_ball_is_pushed_out_and_grips_within_coulombs_cone(block: GelBlock) -> None:
    aside = [BallPose(centre_mm=(0.1 * k, 0.0, RADIUS - 0.25)) for k in range(1, 6)]
    path = [down(-0.1), *[down(d) for d in (0.05, 0.1, 0.15, 0.2, 0.25)], *aside]
    moments = pressed(block, path, radius_mm=RADIUS, friction=FRICTION)
    assert not moments[0].force_N.any()
    totals = np.stack([m.force_N.sum(axis=0) for m in moments])
    assert (np.diff(totals[:6, 2]) > 0).all()
    np.testing.assert_allclose(totals[:6, :2], 0.0, atol=1e-6)  # straight down: no side force
    assert totals[-1, 0] == pytest.approx(-FRICTION * totals[-1, 2], rel=0.1)  # dragged until all of it slips
    last, centre = moments[-1], np.array([0.5, 0.0, RADIUS - 0.25])
    touching = last.force_N.any(axis=1)
    place = np.column_stack([block.face_mm, np.zeros(len(block.face_mm))]) + last.displacement_mm
    arm = (place - centre)[touching]
    inward = -arm / np.linalg.norm(arm, axis=1, keepdims=True)
    push = (last.force_N[touching] * inward).sum(axis=1)
    drag = np.linalg.norm(last.force_N[touching] - push[:, None] * inward, axis=1)
    assert (push > 0).all()
    assert (drag <= FRICTION * push * (1 + 1e-6)).all()
    # what touches lies on the ball but for the contact's own stiffness
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), RADIUS, atol=0.01)


def test_a_contact_past_the_reach_is_refused(block: GelBlock) -> None:
    with pytest.raises(NotInEquilibrium, match="grew past"):
        pressed(block, [down(-0.1), down(0.3), down(0.7), down(1.0)], radius_mm=RADIUS, friction=FRICTION)
