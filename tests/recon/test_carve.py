"""The voxel hull of a ball: it holds the ball, tends to it with more views, and outvotes bad masks."""

import numpy as np
import pytest
from known_ball import CENTRE, RADIUS_MM, camera_towards, directions, from_rim_px, whole_window

from recon.silhouettes.segmentation import CELLS, Block, carve

LOW, HIGH = CENTRE - 30.0, CENTRE + 30.0
CELL_MM = 60.0 / CELLS
BALL_MM3 = 4 / 3 * np.pi * RADIUS_MM**3


def masks_of(count: int) -> list[np.ndarray]:
    return [from_rim_px() > 0] * count


def carved(masks, towards, **how) -> Block:
    return carve(
        masks,
        [whole_window()] * len(masks),
        [camera_towards(toward) for toward in towards],
        low_mm=LOW,
        high_mm=HIGH,
        **how,
    )


def volume_mm3(block: Block) -> float:
    return float(block.filled.sum() * block.cell_mm**3)


def test_the_block_holds_the_ball_and_its_volume_falls_to_the_balls_with_more_views():
    centres = LOW + (np.indices((CELLS, CELLS, CELLS)).reshape(3, -1).T + 0.5) * CELL_MM
    inside = np.linalg.norm(centres - CENTRE, axis=1) < RADIUS_MM - 0.2  # a pixel is 0.28 mm there
    volumes = []
    for count in (4, 10, 40):
        block = carved(masks_of(count), directions(count), agreement=1.0)
        assert block.filled.ravel()[inside].all()
        volumes.append(volume_mm3(block) / BALL_MM3)
    assert volumes == sorted(volumes, reverse=True)
    assert volumes[0] > 1.05
    assert volumes[-1] == pytest.approx(1.0, abs=0.03)  # half a pixel, 0.14 mm, of the radius thrice


def test_cells_are_where_the_block_says():
    block = carved(masks_of(24), directions(24))
    assert block.cell_mm == pytest.approx(CELL_MM)
    np.testing.assert_allclose(block.points.mean(axis=0), CENTRE, atol=0.2)
    assert np.linalg.norm(block.points - CENTRE, axis=1).max() < RADIUS_MM + 4.0


def test_two_empty_masks_of_twentyfour_are_outvoted_and_eight_are_not():
    empty = np.zeros_like(from_rim_px(), dtype=bool)
    few = carved([empty] * 2 + masks_of(22), directions(24))
    many = carved([empty] * 8 + masks_of(16), directions(24))
    assert volume_mm3(few) > 0.98 * BALL_MM3
    assert not many.filled.any()


def test_a_highlight_in_every_mask_leaves_no_hole_inside():
    masks = [mask & ~(np.abs(from_rim_px() - from_rim_px().max()) < 6) for mask in masks_of(24)]
    block = carved(masks, directions(24))
    middle = np.abs(LOW + (np.argwhere(block.filled) + 0.5) * block.cell_mm - CENTRE).max(axis=1) < 3.0
    assert volume_mm3(block) > 0.98 * BALL_MM3
    assert middle.sum() >= 4**3  # cells of 1.36 mm within 3 mm of the centre each way


def test_of_two_bodies_the_larger_is_kept():
    rows, columns = np.mgrid[: len(from_rim_px()), : len(from_rim_px())]
    speck = np.hypot(rows - 8, columns - 100) < 6
    towards = np.tile([[0.0, -1.0, 0.0]], (4, 1))  # all from one side, so that the speck is a body, too
    alone = carved(masks_of(4), towards)
    with_speck = carved([mask | speck for mask in masks_of(4)], towards)
    assert alone.filled.any()
    np.testing.assert_array_equal(with_speck.filled, alone.filled)


def test_cells_that_too_few_views_have_in_sight_are_none():
    away = [
        camera_towards(direction, off_axis=np.array([400.0, 0.0, 0.0])) for direction in directions(24)[:12]
    ]
    cameras = [*away, *(camera_towards(direction) for direction in directions(24)[:2])]
    block = carve(masks_of(14), [whole_window()] * 14, cameras, low_mm=LOW, high_mm=HIGH)
    assert not block.filled.any()


def test_the_column_under_a_block_reaches_the_floor_and_spreads_by_its_reach():
    filled = np.zeros((9, 9, 12), bool)
    filled[4, 4, 7] = True
    block = Block(filled, np.array([10.0, 20.0, 0.0]), 2.0)
    column = block.with_column(reach=2)
    points = {tuple(point) for point in column.points}
    above = (10 + 4.5 * 2.0, 20 + 4.5 * 2.0)
    assert {(above[0], above[1], 1.0 + 2.0 * k) for k in range(10)} <= points  # from two above to the floor
    assert (above[0], above[1], 1.0 + 2.0 * 10) not in points
    assert (above[0] + 4.0, above[1], 1.0) in points
    assert (above[0] + 6.0, above[1], 1.0) not in points
    assert column.points[:, 2].min() == 1.0
