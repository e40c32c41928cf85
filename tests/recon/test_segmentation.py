"""Segmentation of drawn photos of an egg whose outline in every photo is a conic."""

from functools import cache

import numpy as np
from mat_scene import Egg, photographed, ring
from refusals import refused
from scipy.ndimage import binary_dilation

from recon.recon_failure import ReconProblem
from recon.silhouettes.all_views import _whole as whole_views
from recon.silhouettes.mask import (
    Behind,
    Window,
    cells_of,
    colour_density,
    colour_log_odds,
    ground_density,
    ground_noise,
    lab,
    looks_like,
    strange_share,
)  # fmt: skip
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

SIDE = 80


def test_ink_as_dark_as_the_skin_is_alike_and_paper_is_not():
    rng = np.random.default_rng(0)
    skin = lab(np.clip(rng.normal([40, 30, 35], 4, (60, 60, 3)), 0, 255).astype(np.uint8)).reshape(-1, 3)
    scene = np.zeros((10, 30, 3), np.uint8)
    scene[:, :10], scene[:, 10:20], scene[:, 20:] = (38, 32, 33), (225, 228, 230), (40, 60, 150)
    similar = looks_like(lab(scene), skin)
    assert similar[:, :10].all()
    assert not similar[:, 10:].any()


def paper(level: float) -> Behind:
    colours = np.tile(np.array([level, 1.0, 6.0], np.float32), (SIDE, SIDE, 1))
    return Behind(colours, colours, colours, np.zeros((SIDE, SIDE, 2)), np.ones((SIDE, SIDE), bool))


def in_shadow(colours: np.ndarray, light: float) -> np.ndarray:
    """CIE Lab of the same surface under a share of the light, where every L* is above 8."""
    k = light ** (1 / 3)
    return np.stack(
        [k * (colours[..., 0] + 16) - 16, k * colours[..., 1], k * colours[..., 2]], axis=-1
    ).astype(np.float32)


def test_a_shadow_that_moved_is_ground_and_dark_skin_in_its_place_is_not():
    rng = np.random.default_rng(3)
    behind = paper(85.0)
    seen = behind.colours + rng.normal(0, 0.8, behind.colours.shape).astype(np.float32)
    seen[:, 40:] = in_shadow(seen[:, 40:], 0.4)  # half of the ground
    noise = ground_noise(seen, behind, np.ones((SIDE, SIDE), bool))
    assert 0.4 < noise.shadow_share < 0.6
    skin = rng.normal([22.0, 14.0, 6.0], 3.0, (4000, 3)).astype(np.float32)
    palette = colour_density(cells_of(skin))
    nothing = np.zeros((SIDE, SIDE))
    picture = seen.copy()
    picture[:20] = skin[: 20 * SIDE].reshape(20, SIDE, 3)
    log_odds = colour_log_odds(
        palette[cells_of(picture)], ground_density(picture, behind, noise), nothing, nothing
    )
    assert (log_odds[:20] > 2).mean() > 0.98
    assert (log_odds[20:] < -2).mean() > 0.98


def test_ground_that_the_plate_does_not_tell_is_strange_nearby_and_nowhere_else():
    sure = np.ones((400, 400), bool)
    sure[150:250, 150:250] = False
    on_background = np.full((400, 400), 1e-3)
    on_background[:, :150] = 1e-9
    share = strange_share(on_background, np.full((400, 400), 1e-4), sure)
    assert share[:, :60].min() > 0.5
    assert share[200, 160] > share[200, 240]
    assert share[:, 340:].max() < 0.05


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


def test_from_low_cameras_the_first_block_is_the_egg_though_nothing_is_known_of_the_wall_behind():
    cameras = ring(24, width=WIDTH, height=HEIGHT)[::3]  # 20 degrees above the ground
    photos = photographed(cameras, egg=EGG, mat=None)
    points = first_block(SegmentationScene([p.image for p in photos], cameras, LOW, HIGH)).points
    assert np.abs(points.mean(axis=0)[:2] - EGG.centre[:2]).max() < 3.0
    assert np.quantile(EGG.misses_mm(points), 0.9) < 4.0


def test_where_nothing_stands_there_is_no_fruit():
    cameras = ring(6, width=240, height=180)
    bare = SegmentationScene([p.image for p in photographed(cameras, egg=None, mat=None)], cameras, LOW, HIGH)
    with refused(ReconProblem.NO_FRUIT, "drupe found no fruit"):
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
        assert float((mask & egg).sum() / (mask | egg).sum()) > 0.95
        assert ((view_log_odds > 0) == egg)[~edge].mean() > 0.95


def test_a_fruit_cut_off_in_all_photos_but_two_is_refused():
    few = SegmentationScene(scene().images[:2], scene().cameras[:2], LOW, HIGH)
    with refused(ReconProblem.FRUIT_CUT_OFF, "2 of 2 photos show the whole fruit"):
        whole_views(few, ball_block(9))


def test_a_refusal_for_a_cut_fruit_names_the_photos_that_it_reaches_beyond():
    words = r"0 of 8 photos .* beyond 000\.png, .* and 2 more\..*surroundings"
    with refused(ReconProblem.FRUIT_CUT_OFF, words):
        whole_views(scene(), ball_block(40))
