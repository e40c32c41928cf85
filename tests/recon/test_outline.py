"""Outlines and segmentation of drawn photos whose edges are known ellipses."""

from functools import cache

import cv2
import numpy as np
import pytest
from jaxtyping import Bool, Float
from level_camera import camera_at
from mat_scene import Egg, photographed, ring
from refusals import refused
from scipy.ndimage import binary_dilation
from scipy.special import ndtri

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
from recon.silhouettes.outline import (
    SAMPLES,
    STEP_SHARE,
    Outline,
    kept_near,
    outline_of,
    sharpened,
    silhouette_of_outline,
    snapped,
)
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
from recon.silhouettes.star_cut import best_rings, star_cuts

SIDE = 220
CENTRE = np.array([108.0, 112.0])


def disc(radius_px: float) -> Bool[np.ndarray, "h w"]:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    return np.asarray(np.hypot(columns - CENTRE[0], rows - CENTRE[1]) < radius_px)


def painted(mask: Bool[np.ndarray, "h w"], rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    colours = np.where(mask[..., None], [30.0, 25.0, 15.0], [80.0, 0.0, 6.0]) + rng.normal(
        0, 1.5, (SIDE, SIDE, 3)
    )
    return cv2.GaussianBlur(colours.astype(np.float32), (0, 0), 0.8)


def test_a_highlight_that_looks_like_ground_takes_no_bite_out_of_the_fruit():
    rng = np.random.default_rng(0)
    truth = disc(70)
    log_odds = np.where(truth, 3.0, -3.0).astype(np.float32)
    log_odds[105:125, 80:98] = -3.0
    (cut,) = star_cuts([log_odds], [painted(truth, rng)], [CENTRE + np.array([5.0, -4.0])])
    assert float((cut & truth).sum() / (cut | truth).sum()) > 0.975


def test_the_path_is_the_best_of_all_closed_ones():
    gain = np.random.default_rng(3).normal(0, 2, (4, 6, 4)).astype(np.float32)
    paths = best_rings(gain, bend=0.7, steepest=1)
    every = np.stack(np.meshgrid(*[np.arange(4)] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    steps = np.abs(np.diff(every, axis=1, append=every[:, :1]))
    closed = every[(steps[:, :-1] <= 1).all(1) & (steps[:, -1] == 0)]
    for bounds, path in zip(gain, paths, strict=True):
        assert np.abs(np.diff(path)).max() <= 1
        assert path[0] == path[-1]
        starts = closed[closed[:, 0] == path[0]]
        worth = bounds[np.arange(6), starts].sum(1) - 0.7 * np.abs(np.diff(starts, axis=1)).sum(1)
        path_worth = bounds[np.arange(6), path].sum() - 0.7 * np.abs(np.diff(path)).sum()
        assert path_worth >= worth.max() - 1e-4


SIDE_PX = 260
MIDDLE = np.array([128.3, 131.6])
SEMI = np.array([92.0, 78.0])
TURN = np.linspace(0, 2 * np.pi, SAMPLES, endpoint=False)
BLUR_PX = 1.0
CAMERA = camera_at(np.zeros(3), [0.0, 0.0, 1.0], size_px=(SIDE_PX, SIDE_PX), focal_px=500.0)


def off_px(points: np.ndarray) -> np.ndarray:
    """Distance of points to the ellipse, positive outside, to first order in it (Sampson)."""
    local = (points - MIDDLE) / SEMI
    size = np.linalg.norm(local, axis=-1)
    return (size - 1) * size / np.linalg.norm(local / SEMI, axis=-1)


def pixels() -> np.ndarray:
    rows, columns = np.mgrid[:SIDE_PX, :SIDE_PX]
    return np.stack([columns, rows], axis=-1).astype(float)


def ellipse(grown_px: float | np.ndarray = 0.0) -> Outline:
    """The true outline, moved outward by so much."""
    circle = np.column_stack([np.cos(TURN), np.sin(TURN)])
    normals = circle / SEMI
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Outline(MIDDLE + circle * SEMI + np.reshape(grown_px, (-1, 1)) * normals, normals, 0.0)


def photo(
    noise: float, *, skin=(40, 60, 170), ground=(190, 200, 205), blur_px: float = BLUR_PX
) -> np.ndarray:
    """A fruit on its ground in linear light, sixteen rays a pixel, blurred, as a photo's bytes."""
    steps = (np.arange(4) - 1.5) / 4
    at = pixels()[:, :, None, None] + np.stack(np.meshgrid(steps, steps), axis=-1)
    share = (off_px(at) < 0).mean(axis=(2, 3))[..., None]
    light = share * (np.array(skin) / 255) ** 2.2 + (1 - share) * (np.array(ground) / 255) ** 2.2
    light = cv2.GaussianBlur(light, (0, 0), blur_px)
    bytes_ = 255 * light ** (1 / 2.2) + np.random.default_rng(1).normal(0, noise, light.shape)
    return np.clip(bytes_ + 0.5, 0, 255).astype(np.uint8)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_outline_of_a_mask_is_the_ellipse_evenly_sampled_with_outward_normals():
    outline = outline_of(off_px(pixels()) < 0)
    assert len(outline.points) == SAMPLES
    assert np.abs(off_px(outline.points) + 0.5).max() < 0.75  # pixels inside end half a pixel before the edge
    steps = np.linalg.norm(np.roll(outline.points, -1, axis=0) - outline.points, axis=1)
    assert steps.std() < 0.05 * steps.mean()
    truth = (outline.points - MIDDLE) / SEMI**2
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    assert np.sum(outline.normals * truth, axis=1).min() > np.cos(np.radians(5))


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_an_outline_is_sharpened_to_a_fraction_of_a_pixel(noise):
    """At a share of 0.4 of a step blurred by s the edge lies ndtri(0.6) s outside its middle."""
    start = ellipse(2.0 + np.sin(5 * TURN))
    outline, whole = sharpened(start, Window(photo(noise), (0, 0), 1), search=True)
    blur_px = np.sqrt(BLUR_PX**2 + 1 / 12 + 1 / 6)  # with the pixel's own area and reading between pixels
    expected = ndtri(1 - STEP_SHARE) * blur_px
    assert whole.shrink == 1
    assert np.median(off_px(outline.points)) == pytest.approx(expected, abs=0.04)
    assert rms(off_px(outline.points) - expected) < 0.06 + 0.02 * noise
    assert outline.clear_share > 0.98


def test_where_skin_and_ground_are_alike_the_outline_stays_and_says_so():
    start = ellipse(1.0)
    outline, _ = sharpened(start, Window(photo(1.0, skin=(190, 200, 203)), (0, 0), 1), search=False)
    assert outline.clear_share < 0.05
    assert rms(off_px(outline.points) - 1.0) < 0.1


def test_snapping_finds_the_edge_by_colour_step_and_odds_within_its_reach():
    rng = np.random.default_rng(3)
    truth = off_px(pixels()) < 0
    log_odds = np.where(truth, 1.0, -1.0) + rng.normal(0, 2.0, truth.shape)
    start = ellipse(3.0 * np.sin(3 * TURN))
    (outline,) = snapped([start], [log_odds], [lab(photo(2.0))], reach_px=6.0, most_log_odds=2.5)
    assert rms(off_px(start.points)) > 2.0
    assert rms(off_px(outline.points)) < 0.5  # shifts are in steps of half a pixel


def test_a_bite_deeper_than_allowed_is_given_back_and_a_shallow_one_stays():
    expected = ellipse()
    bite = np.exp(-((TURN - 2.0) ** 2) / 0.02)
    deep = kept_near(ellipse(-12.0 * bite), expected, inward_px=3.5)
    shallow = kept_near(ellipse(-2.0 * bite), expected, inward_px=3.5)
    assert off_px(deep.points).min() > -3.6
    assert off_px(shallow.points).min() < -1.8
    assert off_px(kept_near(ellipse(12.0 * bite), expected, inward_px=3.5).points).max() > 11.0


def test_the_silhouette_of_an_outline_has_the_signed_distance_near_it_and_is_clipped_further_off():
    window = Window(np.zeros((SIDE_PX, SIDE_PX, 3), np.uint8), (0, 0), 1)
    distance_px = silhouette_of_outline(ellipse(), window, CAMERA).distance_px
    truth = -off_px(pixels())
    near = np.abs(truth) < 8.0
    assert np.abs(distance_px - truth)[near].max() < 0.25
    assert np.abs(distance_px).max() == pytest.approx(12.0)
    assert (distance_px[truth > 20] == 12.0).all()
    assert (distance_px[truth < -20] == -12.0).all()


PHOTO_SIDE = 80


def test_ink_as_dark_as_the_skin_is_alike_and_paper_is_not():
    rng = np.random.default_rng(0)
    skin = lab(np.clip(rng.normal([40, 30, 35], 4, (60, 60, 3)), 0, 255).astype(np.uint8)).reshape(-1, 3)
    scene = np.zeros((10, 30, 3), np.uint8)
    scene[:, :10], scene[:, 10:20], scene[:, 20:] = (38, 32, 33), (225, 228, 230), (40, 60, 150)
    similar = looks_like(lab(scene), skin)
    assert similar[:, :10].all()
    assert not similar[:, 10:].any()


def paper(level: float) -> Behind:
    colours = np.tile(np.array([level, 1.0, 6.0], np.float32), (PHOTO_SIDE, PHOTO_SIDE, 1))
    return Behind(
        colours,
        colours,
        colours,
        np.zeros((PHOTO_SIDE, PHOTO_SIDE, 2)),
        np.ones((PHOTO_SIDE, PHOTO_SIDE), bool),
    )


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
    noise = ground_noise(seen, behind, np.ones((PHOTO_SIDE, PHOTO_SIDE), bool))
    assert 0.4 < noise.shadow_share < 0.6
    skin = rng.normal([22.0, 14.0, 6.0], 3.0, (4000, 3)).astype(np.float32)
    palette = colour_density(cells_of(skin))
    nothing = np.zeros((PHOTO_SIDE, PHOTO_SIDE))
    picture = seen.copy()
    picture[:20] = skin[: 20 * PHOTO_SIDE].reshape(20, PHOTO_SIDE, 3)
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
