"""Segmentation of drawn photos of an egg whose outline in every photo is a conic."""

from functools import cache

import numpy as np
from mat_scene import Egg, photographed, ring
from refusals import refused
from scipy.ndimage import binary_dilation

from recon.recon_failure import ReconProblem
from recon.silhouettes.all_views import _whole as whole_views
from recon.silhouettes.mask import Window
from recon.silhouettes.segmentation import (
    Block,
    Bounds,
    CutPhoto,
    SegmentationScene,
    eroded,
    first_block,
    learned_log_odds,
    pixels_of,
)

EGG = Egg()
WIDTH, HEIGHT = 240, 180
LOW, HIGH = np.array([-45.0, -45.0, 0.0]), np.array([45.0, 45.0, 70.0])


@cache
def scene() -> SegmentationScene:
    cameras = ring(8, width=WIDTH, height=HEIGHT)
    return SegmentationScene([p.image for p in photographed(cameras, egg=EGG, mat=None)], cameras, LOW, HIGH)


@cache
def block() -> Block:
    return first_block(scene())


def truth(view: CutPhoto) -> np.ndarray:
    """The egg in a view's shrunk window."""
    columns, rows = view.window.small_size_px
    v, u = np.mgrid[:rows, :columns]
    shrink = view.window.shrink
    pixels = np.stack([u.ravel(), v.ravel()], axis=1) * shrink + (shrink - 1) / 2 + view.window.corner_px
    return EGG.covers(view.camera, pixels).reshape(rows, columns)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def ball_block(radius_cells: int = 12, cell_mm: float = 2.0) -> Block:
    """A ball of cells about (0, 0, 30) mm."""
    side = 2 * radius_cells + 6
    centres = (np.indices((side,) * 3).T + 0.5 - side / 2) * cell_mm
    away_mm = np.linalg.norm(centres, axis=-1).T
    filled = away_mm < radius_cells * cell_mm
    return Block(filled, np.array([0.0, 0.0, 30.0]) - side / 2 * cell_mm, cell_mm)


def test_the_first_block_is_in_the_egg_and_fills_most_of_its_upper_half():
    """Its lower flank may be missing: the plate still has the egg's own colours there."""
    cells = block()
    away = EGG.misses_mm(cells.points)
    centres = cells.low_mm + (np.indices(cells.filled.shape).reshape(3, -1).T + 0.5) * cells.cell_mm
    upper = (EGG.misses_mm(centres) < -cells.cell_mm) & (centres[:, 2] > EGG.centre[2])
    assert np.quantile(away, 0.9) < 2 * cells.cell_mm  # eight views leave a peak above it
    assert cells.filled.ravel()[upper].mean() > 0.8
    assert np.linalg.norm(cells.points.mean(axis=0)[:2] - EGG.centre[:2]) < 2 * cells.cell_mm


def test_where_nothing_stands_there_is_no_fruit():
    cameras = ring(6, width=240, height=180)
    bare = SegmentationScene([p.image for p in photographed(cameras, egg=None, mat=None)], cameras, LOW, HIGH)
    with refused(ReconProblem.NO_FRUIT):
        first_block(bare)


def test_learned_odds_and_their_masks_part_the_egg_from_its_ground():
    column = block().with_column(reach=2)
    views = scene().views(column.points, margin=0.12, side_px=120)
    bounds = [
        Bounds(eroded(pixels_of(block(), v.window, v.camera), 8.0), pixels_of(column, v.window, v.camera))
        for v in views
    ]
    covered = [
        pixels_of(column, Window(i, (0, 0), 4), c)
        for i, c in zip(scene().images, scene().cameras, strict=True)
    ]
    log_odds, masks = learned_log_odds(views, bounds, scene().background(covered), EGG.centre)
    for view, view_log_odds, mask in zip(views, log_odds, masks, strict=True):
        egg = truth(view)
        edge = binary_dilation(egg, iterations=2) & ~binary_dilation(egg, iterations=1)
        assert overlap(mask, egg) > 0.95
        assert ((view_log_odds > 0) == egg)[~edge].mean() > 0.95


def test_a_fruit_cut_off_in_all_photos_but_two_is_refused():
    few = SegmentationScene(scene().images[:2], scene().cameras[:2], LOW, HIGH)
    with refused(ReconProblem.FRUIT_CUT_OFF, "2 of 2 photos show the whole fruit"):
        whole_views(few, ball_block(9))
