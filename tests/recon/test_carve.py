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


def test_two_empty_masks_of_twentyfour_are_outvoted_and_eight_are_not():
    empty = np.zeros_like(from_rim_px(), dtype=bool)
    few = carved([empty] * 2 + masks_of(22), directions(24))
    many = carved([empty] * 8 + masks_of(16), directions(24))
    assert volume_mm3(few) > 0.98 * BALL_MM3
    assert not many.filled.any()
