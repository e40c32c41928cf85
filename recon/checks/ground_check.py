"""Evidence beside the mesh's rim: do the photos show ground outside of it and skin inside?

A point of the support plane that the mesh leaves free in several photos must keep its colour in them all. The
check needs no outlines and no background plate, but it is not independent evidence. What misleads both, such
as a wrong camera or ground mirrored in the skin, goes unnoticed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from recon.cameras.camera import Camera
from recon.checks.rim_samples import Profiles, Rim, profiles_of, rims_of
from recon.picture_values import Pictures
from recon.silhouettes.mask import (
    DARKEST_SHADOW,
    DEGREES_OF_FREEDOM,
    LEAST_NOISE_LAB,
    cells_of,
    colour_density,
)
from recon.triangle_mesh import Faces, Vertices

REACH_PX = 10
"""Reach of a profile to either side of the rim, px."""
REACH_SHARE = 0.05
"""The same as a share of the fruit's diameter; the larger counts."""
MOST_EVIDENCE = 3.0
"""Limit of a pixel's evidence for or against skin (natural log of a ratio of densities)."""
MOST_OF_SHADOW = 0.5
"""The same for darkened ground: skin that mirrors the ground at its rim has similar colours."""
CORRELATED = 0.6
"""Weight of a pixel's evidence, below one because neighbouring pixels correlate. The pixels of the two
neighbouring samples count half as much."""
EDGE_EVIDENCE, EDGE_LAB = 16.0, 25.0
"""Limit of a colour step's evidence, averaged over a sample and its neighbours (STEP_POOLING), and the step
(Lab units) that reaches it."""
STEP_POOLING = (0.25, 0.5, 0.25)
"""Weights of a sample and its two neighbours along the rim, whose steps are averaged (binomial)."""
STEP_PX = 3
"""Range of the search for the steepest place of a step, px: blurred steps are up to five wide."""
PRIOR_SCALE_PX = 1.5
"""Scale of the Cauchy prior over the edge's distance from the rim, px: meshes are mostly right to a pixel.
With this and STEP_PX the error fell from 0.9 to 0.5 px on a dark glossy plum, elsewhere it stayed 0.4 px."""
SHADOW_SHARE = 0.15
"""Prior probability that the ground beside a fruit is darkened."""
LEAST_DENSITY = 2e-7
"""Density (per Lab unit cubed) of colours that neither model expects."""


@dataclass(frozen=True, kw_only=True)
class RimEvidence:
    """Where each rim sample's photo puts the skin's edge, measured from the mesh's rim.

    Sample i is the point (1 - t) a + t b of the mesh's edge between vertices `a` and `b`, as photo `view`
    sees it. `offset_mm` is the posterior mean of the edge's place (positive: the fruit reaches further than
    the mesh), `sd_mm` its standard deviation, `pixel_mm` a pixel's size there. `known`: three other photos
    show the ground's colour on most of the profile. `turn`: direction from the fruit's middle in the picture
    (radians; 0 right, pi / 2 up).
    """

    view: Int[np.ndarray, " k"]
    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    offset_mm: Float[np.ndarray, " k"]
    sd_mm: Float[np.ndarray, " k"]
    pixel_mm: Float[np.ndarray, " k"]
    known: Bool[np.ndarray, " k"]
    turn: Float[np.ndarray, " k"]


def rim_evidence(
    images: Pictures, cameras: Sequence[Camera], vertices: Vertices, faces: Faces
) -> RimEvidence:
    """The place of the skin's edge along the normals of the mesh's rim, in every photo.

    Each pixel along a normal contributes l = log p(colour | skin) - log p(colour | ground). The other photos
    give the ground's colour at the same point of z = 0 (median, spread over photos, range of eight
    neighbours). It may be darkened (L* + 16, a*, b* times one k in DARKEST_SHADOW..1). This photo gives the
    skin's colour further inside; l shrinks to 0 for similar colours. The evidence for an edge at d is sum_{o
    < d} l - sum_{o > d} l. A colour step that the ground does not explain adds to it. The posterior over d
    (Cauchy prior of scale PRIOR_SCALE_PX) gives `offset_mm` and `sd_mm`. Cameras have no distortion.
    """
    rim_views, rims = rims_of(images, cameras, vertices, faces)
    diameter_px = float(np.median([np.ptp(s.camera.project(vertices), axis=0).max() for s in rim_views]))
    reach = max(REACH_PX, round(REACH_SHARE * diameter_px))
    offsets = np.arange(-reach - 6, reach + 7, dtype=float)
    profiles = profiles_of(rim_views, rims, offsets, vertices)
    return _evidence(rims, profiles, offsets, reach)


def _evidence(
    rims: Sequence[Rim], profiles: Profiles, offsets: Float[np.ndarray, " o"], reach: int
) -> RimEvidence:
    """The edge at each rim sample, from the colours of its profile."""
    view = np.repeat(np.arange(len(rims)), [len(r.t) for r in rims])
    offset_px, sd_px = np.zeros((2, len(view)))
    known = np.zeros(len(view), bool)
    for k in range(len(rims)):
        mine = view == k
        if mine.sum() < 8:
            continue
        lit, dim, skin, separable = _densities(profiles, mine, offsets)
        ok = profiles.known[mine]
        ground = (1 - SHADOW_SHARE) * lit + SHADOW_SHARE * dim
        log_odds = np.log(skin + LEAST_DENSITY) - np.log(ground + LEAST_DENSITY)
        least = np.where(dim > lit, -MOST_OF_SHADOW, -MOST_EVIDENCE)
        log_odds = np.where(ok, separable * np.clip(log_odds, least, MOST_EVIDENCE), 0.0)
        offset_px[mine], sd_px[mine] = _edge_of(log_odds, _steps(profiles, mine), offsets, reach)
        known[mine] = ok[:, np.abs(offsets) <= reach].mean(1) > 0.7
    joined = {f: np.concatenate([getattr(r, f) for r in rims]) for f in ("a", "b", "t", "pixel_mm")}
    return RimEvidence(
        view=view,
        **joined,
        offset_mm=offset_px * joined["pixel_mm"],
        sd_mm=sd_px * joined["pixel_mm"],
        known=known,
        turn=np.concatenate([_turn(r.pixel) for r in rims]),
    )


def _turn(pixel: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
    """Directions (rad) of a rim's pixels from its middle; rows count downwards."""
    if not len(pixel):
        return np.zeros(0)
    across, down = (pixel - (pixel.min(0) + pixel.max(0)) / 2).T
    return np.asarray(np.arctan2(-down, across))


def _densities(
    profiles: Profiles, mine: Bool[np.ndarray, " p"], offsets: Float[np.ndarray, " o"]
) -> tuple[
    Float[np.ndarray, "k o"], Float[np.ndarray, "k o"], Float[np.ndarray, "k o"], Float[np.ndarray, "k o"]
]:
    """Densities of one photo's profile colours as lit ground, darkened ground, and skin. Also, in 0..1, how
    different the colours of skin and ground are.

    Like ground_noise and ground_density of recon.silhouettes.mask, but the other photos give the ground, with
    a spread for every pixel and channel. The noise is from a few thousand pixels of profiles, too few to show
    shadows. These are assumed uniform over k with the prior SHADOW_SHARE.
    """
    colours, known = profiles.colours[mine], profiles.known[mine]
    ground = profiles.ground[mine]
    off = colours - np.clip(colours, profiles.lowest[mine], profiles.highest[mine])
    sure = known & (offsets >= 6)
    noise = np.array([2.0, 1.5, 1.5])
    least = np.array(LEAST_NOISE_LAB)[[0, 1, 1]]
    if sure.sum() > 50:
        noise = np.clip(1.48 * np.median(np.abs(off[sure]), axis=0), least, [6.0, 5.0, 5.0])
    scale = np.hypot(noise, profiles.spread[mine])
    lit = student(off, scale)
    k = (colours[..., 0] + 16) / (ground[..., 0] + 16)
    tint = colours[..., 1:] - k[..., None] * ground[..., 1:]
    square = np.sum((tint / (1.5 * scale[..., 1:])) ** 2, axis=-1)
    plane = (
        1 / (2 * np.pi * 2.25 * np.prod(scale[..., 1:], axis=-1)) * (1 + square / DEGREES_OF_FREEDOM) ** -3.5
    )
    dim = np.where(
        (k > DARKEST_SHADOW) & (k <= 1), plane / ((1 - DARKEST_SHADOW) * (ground[..., 0] + 16)), 0.0
    )
    deep = colours[:, offsets <= -5]
    middle = ndimage.median_filter(np.median(deep, axis=1), size=(9, 1), mode="wrap")
    wide = 1.48 * ndimage.median_filter(
        np.median(np.abs(deep - middle[:, None]), axis=1), size=(9, 1), mode="wrap"
    )
    palette = colour_density(cells_of(deep.reshape(-1, 3)))

    def skin(of: Float[np.ndarray, "k o 3"]) -> Float[np.ndarray, "k o"]:
        near = student(of - middle[:, None], np.maximum(wide, [4.0, 2.5, 2.5])[:, None])
        return np.asarray(0.5 * near + 0.5 * palette[cells_of(of)])

    separable = np.log(student(0 * off, scale) + LEAST_DENSITY) - np.log(skin(ground) + LEAST_DENSITY)
    return lit, dim, skin(colours), np.clip(separable / MOST_EVIDENCE, 0, 1)


def _steps(profiles: Profiles, mine: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "k o"]:
    """Evidence of an edge at each offset: the jump of the colour that the ground does not explain.

    A high step is blurred over several pixels; only its steepest place counts in full.
    """
    rest = profiles.colours[mine] - profiles.ground[mine]
    rest = np.where(profiles.known[mine][..., None], rest, profiles.colours[mine])
    rest = np.pad(rest, ((0, 0), (2, 2), (0, 0)), mode="edge")
    jump = np.linalg.norm((rest[:, 3:-1] + rest[:, 4:] - rest[:, :-4] - rest[:, 1:-3]) / 2, axis=2)
    steepest = np.maximum(ndimage.maximum_filter1d(jump, 2 * STEP_PX + 1, axis=1), EDGE_LAB)
    return np.asarray(EDGE_EVIDENCE * np.minimum(jump / EDGE_LAB, 1.0) * (jump / steepest) ** 2)


def _edge_of(
    log_odds: Float[np.ndarray, "k o"],
    step: Float[np.ndarray, "k o"],
    offsets: Float[np.ndarray, " o"],
    reach: int,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Posterior mean and standard deviation of the edge's offset (px), pooled over neighbouring samples."""
    pooled = ndimage.convolve1d(log_odds, [0.5, 1.0, 0.5], axis=0, mode="wrap") * CORRELATED
    total = np.cumsum(pooled, axis=1)
    score = 2 * total - pooled - total[:, -1:] + ndimage.convolve1d(step, STEP_POOLING, axis=0, mode="wrap")
    inner = np.abs(offsets) <= reach
    score, at = score[:, inner], offsets[inner]
    score = score - np.log1p((at / PRIOR_SCALE_PX) ** 2)
    weight = np.exp(score - score.max(1, keepdims=True))
    weight /= weight.sum(1, keepdims=True)
    mean = weight @ at
    sd = np.sqrt(np.maximum(weight @ at**2 - mean**2, 0.0) + 1 / 12)
    return mean, sd


def student(off: Float[np.ndarray, "*n 3"], scale: Float[np.ndarray, "*#n 3"]) -> Float[np.ndarray, " *n"]:
    """Student's t density in three dimensions for DEGREES_OF_FREEDOM = 5. At its top it is Γ(4) / (Γ(5/2)
    (5π)^(3/2)) = 0.0725 for unit scales. recon.silhouettes.mask has one and two dimensions, in single
    precision for whole windows.
    """
    square = np.sum((off / scale) ** 2, axis=-1)
    return np.asarray(0.0725 / np.prod(scale, axis=-1) * (1 + square / DEGREES_OF_FREEDOM) ** -4.0)
