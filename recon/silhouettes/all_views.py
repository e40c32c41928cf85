"""All outlines of the fruit: cut from the outside in, then sharpened in rounds of carving and projecting."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from recon.cameras.camera import Camera
from recon.cameras.photos import FEWEST_PHOTOS
from recon.learned.fruit_model import FruitModel
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.carve import AGREEMENT, Block
from recon.silhouettes.hull import Silhouette, ball, drawn, silhouette_of_mask, split, visual_hull
from recon.silhouettes.mask import Window
from recon.silhouettes.outline import (
    enlarged,
    kept_near,
    outline_of,
    sharpened,
    silhouette_of_outline,
    snapped,
)
from recon.silhouettes.segmentation import (
    Bounds,
    CutPhoto,
    SegmentationScene,
    eroded,
    first_block,
    learned_log_odds,
    no_fruit,
    pixels_of,
)  # fmt: skip
from recon.silhouettes.tangent import fitted_to_outlines

LOWEST_AGREEMENT = 0.85
"""Overlap of a photo's outline with the hull of all, below which it is left out. Set by hand."""
MOST_INWARD_PX = 3.5
"""px of the cut picture by which an outline may lie inside what the hull shows. Set by hand."""
OUTLIER_SHARE = 0.03
"""Of the views that may cut away too much in the fit: less than one of 33. Set by hand."""
HULL_OUTLIER_SHARE = (0.25, 0.25, 0.15)
"""Shares of the views that may cut away too much: in the block, and under each cover. Too large a hull is cut
again in the next round, too small a one bounds it wrongly."""
HULL_LEVEL, FIT_LEVEL = 4, 5
"""Subdivisions of an icosahedron, in the first rounds and in the fit: 2562 and 10242 vertices."""
SIDES_PX = (320, 420)
"""px of a photo's cut picture under each cover: finer when the fruit's place is known."""
COVER_SHRINK = 4
"""The ground's cover is computed at a quarter of the photo's sides: its edge is off the fruit anyway."""
SURE_SHARE = 0.06
"""So deep inside a hull, as a share of the window, pixels are surely fruit."""


@dataclass(frozen=True, kw_only=True)
class Cover:
    """What may hide the ground while the background plate is made: the hull grown by a share of the fruit's
    size, and a foot under it, a disc on the ground as wide as a share of the hull.
    """

    grown: float
    foot: float


COVERS = (Cover(grown=0.05, foot=0.6), Cover(grown=0.03, foot=0.35))
"""Shares of the fruit's size, wide at first and closer once the hull is known. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class Round:
    """How far an outline may move, which share of views may cut away too much in the hull of the outlines
    found, how much a pixel's log odds may count against a step of colour, and what is done with the outline
    found: kept near the hull's, sharpened on the photo's own pixels, and before that moved to the steepest
    step nearby.
    """

    reach_px: float
    outlier_share: float
    most_log_odds: float
    keep: bool
    sharpen: bool
    search: bool


ROUNDS = (
    Round(reach_px=6.0, outlier_share=0.12, most_log_odds=2.5, keep=False, sharpen=False, search=False),
    Round(reach_px=4.0, outlier_share=0.05, most_log_odds=0.8, keep=True, sharpen=True, search=True),
    Round(reach_px=3.0, outlier_share=0.05, most_log_odds=0.4, keep=True, sharpen=True, search=False),
    Round(
        reach_px=2.0, outlier_share=OUTLIER_SHARE, most_log_odds=0.4, keep=True, sharpen=True, search=False
    ),
)
"""Of making the outlines sharp, coarse to fine; the surface comes from the last one's. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class FoundFruit:
    """The fruit's outlines in the views that agree, the surface fitted to them, how many rims hold each of
    its vertices, and how far photos and surface agree.
    """

    silhouettes: tuple[Silhouette, ...]
    used: Int[np.ndarray, " v"]
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    support: Float[np.ndarray, " n"]
    agreement: float
    clear_share: float


@dataclass(frozen=True)
class _Hull:
    """The coarse hull of some outlines, fitted to them."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]


def find_fruit(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    cameras: Sequence[Camera],
    *,
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
    level: int,
    agreement: float = AGREEMENT,
    model: FruitModel | None = None,
) -> FoundFruit:
    """The thing that stands on z = 0 inside a box, cut out of every photo. Cameras have no distortion.

    Worked from the outside in: what may be fruit, first a coarse block and everything under it, is unknown in
    the background plate instead of wrong, and there alone pixels may turn into fruit; each hull bounds the
    next. `agreement`: the share of the views that must take a cell of the first block for fruit. `model` is
    asked, too, which pixels are fruit. Raises ReconFailure: no-fruit (nothing stands there), fruit-cut-off
    (fewer than three photos hold it whole).
    """
    scene = SegmentationScene(images, cameras, low_mm, high_mm, model)
    block = first_block(scene, agreement=agreement)
    scene, names = _whole(scene, block)
    centre = block.points.mean(0)
    longest = 2.0 * float(np.linalg.norm(block.points - centre, axis=1).max())

    def hull(silhouettes: Sequence[Silhouette], outlier_share: float, level: int = HULL_LEVEL) -> _Hull:
        vertices, faces = visual_hull(
            silhouettes,
            centre_mm=centre,
            longest_mm=longest,
            floor_mm=0.0,
            level=level,
            outlier_share=outlier_share,
        )
        return _Hull(vertices, faces)

    views, log_odds, masks = _cut_block(scene, block)
    mesh = hull([_of_mask(m, v) for m, v in zip(masks, views, strict=True)], HULL_OUTLIER_SHARE[0])
    for cover, side_px, outlier_share in zip(COVERS, SIDES_PX, HULL_OUTLIER_SHARE[1:], strict=True):
        del views, log_odds, masks  # hundreds of MB, before as much is made anew
        views, log_odds, masks = _cut_hull(scene, mesh, cover, centre, side_px)
        mesh = hull([_of_mask(m, v) for m, v in zip(masks, views, strict=True)], outlier_share)
    kept = _agreeing(views, masks, mesh)
    views, log_odds = [views[i] for i in kept], [log_odds[i] for i in kept]
    coarse = max(HULL_LEVEL, min(level, FIT_LEVEL))
    for step in ROUNDS:
        silhouettes, clear = _refined(views, log_odds, mesh, step)
        rough = hull(silhouettes, step.outlier_share, level=coarse if step is ROUNDS[-1] else HULL_LEVEL)
        surface = fitted_to_outlines(rough.vertices, rough.faces, silhouettes, floor_mm=0.0)
        mesh = _Hull(surface.vertices, rough.faces)
    overlap = [
        _overlap(drawn(mesh.vertices, mesh.faces, s.window, s.camera), s.distance_px > 0) for s in silhouettes
    ]
    return FoundFruit(
        silhouettes=tuple(silhouettes),
        used=names[[v.index for v in views]],
        vertices=split(surface.vertices, coarse, level),
        faces=ball(level)[1],
        support=split(surface.support[:, None], coarse, level)[:, 0],
        agreement=float(np.mean(overlap)),
        clear_share=clear,
    )


def _agreeing(views: Sequence[CutPhoto], masks: Sequence[Bool[np.ndarray, "_ _"]], mesh: _Hull) -> list[int]:
    """Views whose mask is that of the hull; raises ReconFailure, no-fruit, where too few are."""
    overlaps = [
        _overlap(drawn(mesh.vertices, mesh.faces, v.window, v.camera), m)
        for v, m in zip(views, masks, strict=True)
    ]
    kept = [i for i, a in enumerate(overlaps) if a >= LOWEST_AGREEMENT]
    if len(kept) < FEWEST_PHOTOS:
        raise no_fruit(
            f"the outlines of {len(overlaps)} photos do not fit one body (mean overlap "
            f"{np.mean(overlaps):.2f})"
        )
    return kept


def _cut_block(
    scene: SegmentationScene, block: Block
) -> tuple[list[CutPhoto], list[Float[np.ndarray, "_ _"]], list[Bool[np.ndarray, "_ _"]]]:
    """Views, odds and masks, with the block and everything under it as what may be fruit."""
    column = block.with_column(reach=2)
    covered = []
    for image, camera in zip(scene.images, scene.cameras, strict=True):
        covered.append(pixels_of(column, Window(image, (0, 0), COVER_SHRINK), camera))
    views = scene.views(column.points, margin=0.12, side_px=SIDES_PX[0])
    bounds = []
    for view in views:
        inner = pixels_of(block, view.window, view.camera)
        bounds.append(
            Bounds(eroded(inner, 0.5 * SURE_SHARE * len(inner)), pixels_of(column, view.window, view.camera))
        )
    return views, *learned_log_odds(views, bounds, scene.background(covered), block.points.mean(0))


def _cut_hull(
    scene: SegmentationScene, mesh: _Hull, cover: Cover, centre_mm: Float[np.ndarray, "3"], side_px: int
) -> tuple[list[CutPhoto], list[Float[np.ndarray, "_ _"]], list[Bool[np.ndarray, "_ _"]]]:
    """The same with a hull, grown, and a foot under it."""
    size = float(np.ptp(mesh.vertices, axis=0).max())
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    half = np.ptp(mesh.vertices, axis=0) / 2
    foot = np.stack(
        [
            middle[0] + cover.foot * half[0] * np.cos(turn),
            middle[1] + cover.foot * half[1] * np.sin(turn),
            np.zeros_like(turn),
        ],
        axis=1,
    )
    both = np.concatenate([mesh.vertices, foot])

    def perhaps(window: Window, camera: Camera) -> Bool[np.ndarray, "h w"]:
        columns, rows = window.small_size_px
        out = np.zeros((rows, columns), np.uint8)
        outer = cv2.convexHull(window.into_small(camera.project(both)).astype(np.float32))
        cv2.fillConvexPoly(out, np.rint(outer).astype(np.int32), 1)
        depth = float(camera.into(middle[None])[0, 2])
        reach = 2 * round(cover.grown * size * camera.focal_px / depth / window.shrink) + 1
        return np.asarray(cv2.dilate(out, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) > 0)

    covered = [
        perhaps(Window(image, (0, 0), COVER_SHRINK), camera)
        for image, camera in zip(scene.images, scene.cameras, strict=True)
    ]
    views = scene.views(both, margin=0.15, side_px=side_px)
    bounds = []
    for view in views:
        inner = drawn(mesh.vertices, mesh.faces, view.window, view.camera)
        bounds.append(Bounds(eroded(inner, SURE_SHARE * len(inner)), perhaps(view.window, view.camera)))
    return views, *learned_log_odds(views, bounds, scene.background(covered), centre_mm)


def _of_mask(mask: Bool[np.ndarray, "h w"], view: CutPhoto) -> Silhouette:
    return silhouette_of_mask(mask, view.window, view.camera)


def _refined(
    views: list[CutPhoto], log_odds: list[Float[np.ndarray, "_ _"]], mesh: _Hull, step: Round
) -> tuple[list[Silhouette], float]:
    """Every view's outline near the hull's, and the share of it that lies on a clear edge."""
    drawings = [outline_of(drawn(mesh.vertices, mesh.faces, v.window, v.camera)) for v in views]
    expected = [outline for outline in drawings if outline is not None]
    if len(expected) < len(views):
        raise no_fruit("drupe lost its outline during refinement")
    found = snapped(
        expected,
        log_odds,
        [v.colours for v in views],
        reach_px=step.reach_px,
        most_log_odds=step.most_log_odds,
    )
    silhouettes, clear = [], []
    for view, outline, near in zip(views, found, expected, strict=True):
        window = view.window
        if step.sharpen:
            outline, window = sharpened(outline, window, search=step.search)
            near = enlarged(near, view.window.shrink)
        if step.keep:
            outline = kept_near(outline, near, inward_px=MOST_INWARD_PX)
        clear.append(outline.clear_share)
        silhouettes.append(silhouette_of_outline(outline, window, view.camera))
    return silhouettes, float(np.mean(clear))


def _whole(scene: SegmentationScene, block: Block) -> tuple[SegmentationScene, Int[np.ndarray, " v"]]:
    """The photos that hold the whole block, and which they are."""
    whole = []
    for i, camera in enumerate(scene.cameras):
        pixels = camera.project(block.points)
        inside = (pixels > 3) & (pixels < [camera.width_px - 4, camera.height_px - 4])
        if inside.all():
            whole.append(i)
    given = len(scene.cameras)
    if len(whole) < FEWEST_PHOTOS:
        raise ReconFailure(
            ReconProblem.FRUIT_CUT_OFF,
            f"Only {len(whole)} of {given} photos show the whole fruit, expected at least "
            f"{FEWEST_PHOTOS}, better all. Increase the distance. If no photo cuts the fruit off, all "
            "have one height, which leaves its top open. Take photos from two or three heights.",
        )
    if len(whole) == given:
        return scene, np.arange(given)
    kept = SegmentationScene(
        [scene.images[i] for i in whole],
        [scene.cameras[i] for i in whole],
        scene.low_mm,
        scene.high_mm,
        scene.model,
    )
    return kept, np.array(whole, int)


def _overlap(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))
