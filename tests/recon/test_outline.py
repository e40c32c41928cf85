"""Outlines found in pictures whose edge is a known ellipse, blurred and noisy as photos are."""

import cv2
import numpy as np
import pytest
from jaxtyping import Bool, Float
from level_camera import camera_at
from scipy.special import ndtri

from recon.silhouettes.mask import Window, lab
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
    rng = np.random.default_rng(3)
    gain = rng.normal(0, 2, (4, 6, 4)).astype(np.float32)
    paths = best_rings(gain, bend=0.7, steepest=1)
    every = np.stack(np.meshgrid(*[np.arange(4)] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    steps = np.abs(np.diff(every, axis=1, append=every[:, :1]))
    closed = every[(steps[:, :-1] <= 1).all(1) & (steps[:, -1] == 0)]
    for ring, path in zip(gain, paths, strict=True):
        assert np.abs(np.diff(path)).max() <= 1
        assert path[0] == path[-1]
        starts = closed[closed[:, 0] == path[0]]
        worth = ring[np.arange(6), starts].sum(1) - 0.7 * np.abs(np.diff(starts, axis=1)).sum(1)
        path_worth = ring[np.arange(6), path].sum() - 0.7 * np.abs(np.diff(path)).sum()
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
    window = Window(photo(noise), (0, 0), 1)
    outline, whole = sharpened(start, window, search=True)
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
    outward = kept_near(ellipse(12.0 * bite), expected, inward_px=3.5)
    assert off_px(outward.points).max() > 11.0


def test_the_silhouette_of_an_outline_has_the_signed_distance_near_it_and_is_clipped_further_off():
    window = Window(np.zeros((SIDE_PX, SIDE_PX, 3), np.uint8), (0, 0), 1)
    distance_px = silhouette_of_outline(ellipse(), window, CAMERA).distance_px
    truth = -off_px(pixels())
    near = np.abs(truth) < 8.0
    assert np.abs(distance_px - truth)[near].max() < 0.25
    assert np.abs(distance_px).max() == pytest.approx(12.0)
    assert (distance_px[truth > 20] == 12.0).all()
    assert (distance_px[truth < -20] == -12.0).all()
