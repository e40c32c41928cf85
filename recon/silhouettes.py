"""All photos' outlines of the fruit together: masks made sharp in rounds of carving and projecting back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from recon.camera import Camera
from recon.failure import ReconFailure, ReconProblem
from recon.hull import Silhouette, ball, drawn, silhouette_of_mask, split, visual_hull
from recon.outline import enlarged, kept_near, outline_of, sharpened, silhouette_of_outline, snapped
from recon.segmentation import Segmented, block_pixels, no_fruit, segmented
from recon.tangent import settled

LOWEST_AGREEMENT = 0.85
FEWEST_VIEWS = 3
MOST_INWARD_PX = 3.5
DOUBT = 0.03
SETTLED_LEVEL = 5


@dataclass(frozen=True, kw_only=True)
class Round:
    """How far an outline may move, which share of views may be wrong, how much a pixel's odds may count
    against a step of colour, whether the hull is settled on the outlines before, and what is done with the
    outline found.
    """

    reach_px: float
    doubt: float
    most_odds: float
    settle: bool
    keep: bool
    sharpen: bool


ROUNDS = (
    Round(reach_px=10.0, doubt=0.15, most_odds=2.5, settle=False, keep=False, sharpen=False),
    Round(reach_px=6.0, doubt=0.12, most_odds=2.5, settle=True, keep=False, sharpen=False),
    Round(reach_px=5.0, doubt=0.08, most_odds=1.5, settle=True, keep=True, sharpen=False),
    Round(reach_px=4.0, doubt=0.05, most_odds=0.8, settle=True, keep=True, sharpen=True),
    Round(reach_px=3.0, doubt=0.05, most_odds=0.4, settle=True, keep=True, sharpen=True),
)


@dataclass(frozen=True, kw_only=True)
class FoundFruit:
    """The fruit's outlines in the views that agree, the surface settled on them, how many rims hold each of
    its vertices, and how far photos and surface agree.
    """

    silhouettes: tuple[Silhouette, ...]
    used: Int[np.ndarray, " v"]
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    support: Float[np.ndarray, " n"]
    agreement: float
    clear_share: float


def find_fruit(
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    *,
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
    level: int,
) -> FoundFruit:
    """The thing that stands on z = 0 inside a box, cut out of every photo. Cameras have no distortion.

    Raises ReconFailure: no-fruit (nothing stands there), fruit-cut-off (fewer than three photos hold it
    whole).
    """
    found = _whole_views(segmented(images, cameras, low_mm=low_mm, high_mm=high_mm), len(images))
    centre = found.block.points.mean(0)
    longest = 2.0 * float(np.linalg.norm(found.block.points - centre, axis=1).max())

    def hull(
        silhouettes: Sequence[Silhouette], level: int, doubt: float
    ) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
        return visual_hull(
            silhouettes, centre_mm=centre, longest_mm=longest, floor_mm=0.0, level=level, doubt=doubt
        )

    silhouettes = [
        silhouette_of_mask(_near(m, found, i), v.window, v.camera)
        for i, (m, v) in enumerate(zip(found.masks, found.views, strict=True))
    ]
    mesh = hull(silhouettes, 4, ROUNDS[0].doubt)
    agreement = [
        _overlap(drawn(*mesh, v.window, v.camera), m) for v, m in zip(found.views, found.masks, strict=True)
    ]
    kept = [i for i, a in enumerate(agreement) if a >= LOWEST_AGREEMENT]
    if len(kept) < FEWEST_VIEWS:
        raise no_fruit(
            f"the outlines of {len(agreement)} photos do not fit one body (mean overlap "
            f"{np.mean(agreement):.2f})"
        )
    found, silhouettes = found.only(kept), [silhouettes[i] for i in kept]
    clear = 0.0
    for step in ROUNDS:
        vertices, faces = hull(silhouettes, 4, step.doubt)
        if step.settle:
            vertices = settled(vertices, faces, silhouettes, floor_mm=0.0).vertices
        silhouettes, clear = _refined(found, vertices, faces, step)
    coarse = min(level, SETTLED_LEVEL)
    vertices, faces = hull(silhouettes, coarse, DOUBT)
    found_surface = settled(vertices, faces, silhouettes, floor_mm=0.0)
    vertices, faces = split(found_surface.vertices, coarse, level), ball(level)[1]
    support = split(found_surface.support[:, None], coarse, level)[:, 0]
    overlap = [_overlap(drawn(vertices, faces, s.window, s.camera), s.distance_px > 0) for s in silhouettes]
    return FoundFruit(
        silhouettes=tuple(silhouettes),
        used=np.array([v.index for v in found.views], int),
        vertices=vertices,
        faces=faces,
        support=support,
        agreement=float(np.mean(overlap)),
        clear_share=clear,
    )


def _refined(
    found: Segmented, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], step: Round
) -> tuple[list[Silhouette], float]:
    """Every view's outline near the hull's, and the share of it that lies on a clear edge."""
    silhouettes, clear = [], []
    for view, odd in zip(found.views, found.odds, strict=True):
        expected = outline_of(drawn(vertices, faces, view.window, view.camera))
        if expected is None:
            raise no_fruit("its outline was lost while it was refined")
        outline, window = (
            snapped(expected, odd, view.colours, reach_px=step.reach_px, most_odds=step.most_odds),
            view.window,
        )
        if step.sharpen:
            outline, window = sharpened(outline, window)
            expected = enlarged(expected, view.window.shrink)
        if step.keep:
            outline = kept_near(outline, expected, inward_px=MOST_INWARD_PX)
        clear.append(outline.clear_share)
        silhouettes.append(silhouette_of_outline(outline, window, view.camera))
    return silhouettes, float(np.mean(clear))


def _near(mask: Bool[np.ndarray, "h w"], found: Segmented, index: int) -> Bool[np.ndarray, "h w"]:
    """The part of a mask that the block stands for."""
    shadow = block_pixels(found.block, found.views[index])
    return mask & ndimage.binary_dilation(shadow, iterations=max(4, shadow.shape[0] // 20))


def _whole_views(found: Segmented, given: int) -> Segmented:
    """The views whose picture holds the whole block."""
    whole = []
    for i, view in enumerate(found.views):
        pixels = view.camera.project(found.block.points)
        inside = (pixels > 3) & (pixels < [view.camera.width_px - 4, view.camera.height_px - 4])
        if inside.all():
            whole.append(i)
    if len(whole) < FEWEST_VIEWS:
        raise ReconFailure(
            ReconProblem.FRUIT_CUT_OFF,
            f"Only {len(whole)} of {given} photos hold the whole fruit; at least {FEWEST_VIEWS} must, "
            "all should: step back. Where none cuts it off, all were taken from one height, which leaves its "
            "top open: take photos from two or three heights.",
        )
    return found.only(whole)


def _overlap(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))
