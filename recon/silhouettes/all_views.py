"""Outlines of the fruit in all photos: segmented from the outside in, then refined in rounds of hulls."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.files.plain_file import listed
from recon.cameras.camera import Camera
from recon.cameras.photos import FEWEST_PHOTOS
from recon.learned.fruit_model import FruitModel
from recon.picture_values import Pictures
from recon.recon_failure import ReconProblem
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
    AGREEMENT,
    Block,
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
from recon.triangle_mesh import Faces, Mesh, Vertices

LOWEST_AGREEMENT = 0.85
"""Least overlap (intersection over union) of a photo's outline with the hull of all. Set by hand."""
MOST_INWARD_PX = 3.5
"""Largest distance of an outline inside the hull's, px of the photo. Set by hand."""
OUTLIER_SHARE = 0.03
"""Share of the views that may carve too much in the fit: less than one of 33. Set by hand."""
HULL_LEVEL, FIT_LEVEL = 4, 5
"""Subdivisions of an icosahedron, in the first rounds and in the fit: 2562 and 10242 vertices."""
COVER_SHRINK = 4
"""Reduction of the photos for masks that hide the ground: their edges are off the fruit anyway."""
SURE_SHARE = 0.06
"""Depth inside a hull, as a share of the window, from which pixels are certainly fruit."""


@dataclass(frozen=True, kw_only=True)
class Cover:
    """What may hide the ground in the background plate: the dilated hull, and a disc under it on the ground.

    `grown`: dilation over the fruit's size; `foot`: the disc's width over the hull's. `side_px`: side of a
    shrunk window. `outlier_share` of the views may carve too much: too large a hull is carved again in the
    next round, too small a one bounds it wrongly.
    """

    grown: float
    foot: float
    side_px: int
    outlier_share: float


COVERS = (
    Cover(grown=0.05, foot=0.6, side_px=320, outlier_share=0.25),
    Cover(grown=0.03, foot=0.35, side_px=420, outlier_share=0.15),
)
"""Wide at first, closer and finer once the hull is known. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class Round:
    """`reach_px`: largest shift of an outline. `outlier_share` of the views may carve too much;
    `most_log_odds`: limit of a pixel's log odds. `sharpen`: refine the outline at full resolution and keep it
    near the hull's; `search`: before that, move it to the steepest colour step nearby.
    """

    reach_px: float
    outlier_share: float
    most_log_odds: float
    sharpen: bool
    search: bool


ROUNDS = (
    Round(reach_px=6.0, outlier_share=0.12, most_log_odds=2.5, sharpen=False, search=False),
    Round(reach_px=4.0, outlier_share=0.05, most_log_odds=0.8, sharpen=True, search=True),
    Round(reach_px=3.0, outlier_share=0.05, most_log_odds=0.4, sharpen=True, search=False),
    Round(reach_px=2.0, outlier_share=OUTLIER_SHARE, most_log_odds=0.4, sharpen=True, search=False),
)
"""Rounds of refinement, coarse to fine; the last one gives the surface. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class FoundFruit:
    """Outlines in the consistent views, the surface fitted to them, rims at each vertex, mean overlap."""

    silhouettes: tuple[Silhouette, ...]
    used: Int[np.ndarray, " v"]
    vertices: Vertices
    faces: Faces
    support: Float[np.ndarray, " n"]
    agreement: float
    clear_share: float


def find_fruit(
    images: Pictures,
    cameras: Sequence[Camera],
    *,
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
    level: int,
    agreement: float = AGREEMENT,
    model: FruitModel | None = None,
) -> FoundFruit:
    """Outlines and surface of the object on z = 0 inside a box (mm). Cameras have no distortion.

    The current hull or block hides the ground from the background plate, and only pixels inside it may become
    fruit; each hull bounds the next. `agreement`: the share of the views that must not classify a cell of the
    first block as ground. `model` adds its log odds. Raises ReconFailure: no-fruit, fruit-cut-off (fewer than
    three photos show it whole).
    """
    scene = SegmentationScene(images, cameras, low_mm, high_mm, model)
    block = first_block(scene, agreement=agreement)
    scene, names = _whole(scene, block)
    centre = block.points.mean(0)
    longest = 2.0 * float(np.linalg.norm(block.points - centre, axis=1).max())

    def hull(silhouettes: Sequence[Silhouette], outlier_share: float, level: int = HULL_LEVEL) -> Mesh:
        return visual_hull(
            silhouettes,
            centre_mm=centre,
            longest_mm=longest,
            floor_mm=0.0,
            level=level,
            outlier_share=outlier_share,
        )

    def hull_of_masks(cut: Cut, outlier_share: float) -> Mesh:
        views, _, masks = cut
        outlines = [silhouette_of_mask(m, v.window, v.camera) for m, v in zip(masks, views, strict=True)]
        return hull(outlines, outlier_share)

    mesh = hull_of_masks(_cut_block(scene, block), COVERS[0].outlier_share)
    for cover in COVERS[:-1]:
        mesh = hull_of_masks(_cut_hull(scene, mesh, cover, centre), cover.outlier_share)
    views, log_odds, masks = _cut_hull(scene, mesh, COVERS[-1], centre)
    mesh = hull_of_masks((views, log_odds, masks), COVERS[-1].outlier_share)
    kept = _agreeing(views, masks, mesh)
    views, log_odds = [views[i] for i in kept], [log_odds[i] for i in kept]
    coarse = max(HULL_LEVEL, min(level, FIT_LEVEL))
    for step in ROUNDS:
        silhouettes, clear = _refined(views, log_odds, mesh, step)
        rough, faces = hull(silhouettes, step.outlier_share, coarse if step is ROUNDS[-1] else HULL_LEVEL)
        surface = fitted_to_outlines(rough, faces, silhouettes)
        mesh = surface.vertices, faces
    overlap = [_overlap(drawn(*mesh, s.window, s.camera), s.distance_px > 0) for s in silhouettes]
    return FoundFruit(
        silhouettes=tuple(silhouettes),
        used=names[[v.index for v in views]],
        vertices=split(surface.vertices, coarse, level),
        faces=ball(level)[1],
        support=split(surface.support[:, None], coarse, level)[:, 0],
        agreement=float(np.mean(overlap)),
        clear_share=clear,
    )


def _agreeing(views: Sequence[CutPhoto], masks: Sequence[Bool[np.ndarray, "_ _"]], mesh: Mesh) -> list[int]:
    """Views whose mask agrees with the hull; raises ReconFailure (no-fruit) for fewer than three."""
    overlaps = [_overlap(drawn(*mesh, v.window, v.camera), m) for v, m in zip(views, masks, strict=True)]
    kept = [i for i, a in enumerate(overlaps) if a >= LOWEST_AGREEMENT]
    if len(kept) < FEWEST_PHOTOS:
        raise no_fruit(
            f"the outlines of {len(overlaps)} photos do not fit one body (mean overlap "
            f"{np.mean(overlaps):.2f})"
        )
    return kept


Pixels = Callable[[Window, Camera], Bool[np.ndarray, "h w"]]
"""A function that marks pixels of a camera's shrunk window."""
Cut = tuple[list[CutPhoto], list[Float[np.ndarray, "_ _"]], list[Bool[np.ndarray, "_ _"]]]
"""Views, log odds and masks."""


def _cut(
    scene: SegmentationScene,
    around: Float[np.ndarray, "n 3"],
    centre_mm: Float[np.ndarray, "3"],
    *,
    margin: float,
    side_px: int,
    perhaps: Pixels,
    sure: Pixels,
) -> Cut:
    """Segmentation in windows around points; `perhaps` bounds the fruit and hides the ground."""
    covered = [
        perhaps(Window(image, (0, 0), COVER_SHRINK), camera)
        for image, camera in zip(scene.images, scene.cameras, strict=True)
    ]
    views = scene.views(around, margin=margin, side_px=side_px)
    bounds = [Bounds(sure(v.window, v.camera), perhaps(v.window, v.camera)) for v in views]
    return views, *learned_log_odds(views, bounds, scene.background(covered), centre_mm)


def _cut_block(scene: SegmentationScene, block: Block) -> Cut:
    """Segmentation with the block and everything under it as possible fruit."""
    column = block.with_column(reach=2)
    return _cut(
        scene,
        column.points,
        block.points.mean(0),
        margin=0.12,
        side_px=COVERS[0].side_px,
        perhaps=lambda window, camera: pixels_of(column, window, camera),
        sure=lambda window, camera: eroded(
            pixels_of(block, window, camera), 0.5 * SURE_SHARE * window.small_size_px[1]
        ),
    )


def _cut_hull(scene: SegmentationScene, mesh: Mesh, cover: Cover, centre_mm: Float[np.ndarray, "3"]) -> Cut:
    """Segmentation with the dilated hull and a disc under it as possible fruit."""
    vertices, _ = mesh
    size = float(np.ptp(vertices, axis=0).max())
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    middle, half = (vertices.min(0) + vertices.max(0)) / 2, np.ptp(vertices, axis=0) / 2
    foot = middle + cover.foot * half * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    both = np.concatenate([vertices, foot * [1, 1, 0]])

    def perhaps(window: Window, camera: Camera) -> Bool[np.ndarray, "h w"]:
        columns, rows = window.small_size_px
        out = np.zeros((rows, columns), np.uint8)
        outer = cv2.convexHull(window.into_small(camera.project(both)).astype(np.float32))
        cv2.fillConvexPoly(out, np.rint(outer).astype(np.int32), 1)
        depth = float(camera.into(middle[None])[0, 2])
        reach = 2 * round(cover.grown * size * camera.focal_px / depth / window.shrink) + 1
        return np.asarray(cv2.dilate(out, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) > 0)

    return _cut(
        scene,
        both,
        centre_mm,
        margin=0.15,
        side_px=cover.side_px,
        perhaps=perhaps,
        sure=lambda window, camera: eroded(
            drawn(*mesh, window, camera), SURE_SHARE * window.small_size_px[1]
        ),
    )


def _refined(
    views: list[CutPhoto], log_odds: list[Float[np.ndarray, "_ _"]], mesh: Mesh, step: Round
) -> tuple[list[Silhouette], float]:
    """Each view's outline near the hull's, and their mean clear share; raises ReconFailure (no-fruit)."""
    drawings = [outline_of(drawn(*mesh, v.window, v.camera)) for v in views]
    expected = [outline for outline in drawings if outline is not None]
    if len(expected) < len(views):
        raise no_fruit("drupe lost its outline during refinement")
    snapped_outlines = snapped(
        expected,
        log_odds,
        [v.colours for v in views],
        reach_px=step.reach_px,
        most_log_odds=step.most_log_odds,
    )
    silhouettes, clear = [], []
    for view, outline, near in zip(views, snapped_outlines, expected, strict=True):
        window = view.window
        if step.sharpen:
            outline, window = sharpened(outline, window, search=step.search)
            near = enlarged(near, view.window.shrink)
            outline = kept_near(outline, near, inward_px=MOST_INWARD_PX)
        clear.append(outline.clear_share)
        silhouettes.append(silhouette_of_outline(outline, window, view.camera))
    return silhouettes, float(np.mean(clear))


def _whole(scene: SegmentationScene, block: Block) -> tuple[SegmentationScene, Int[np.ndarray, " v"]]:
    """The scene of photos with the whole block, and their indices; raises ReconFailure (fruit-cut-off)."""
    points, given = block.points, len(scene.cameras)
    whole = [i for i, camera in enumerate(scene.cameras) if camera.shows(camera.project(points), 3).all()]
    if len(whole) < FEWEST_PHOTOS:
        cut = [camera.name for i, camera in enumerate(scene.cameras) if i not in whole]
        raise ReconProblem.FRUIT_CUT_OFF.failure(
            f"Only {len(whole)} of {given} photos show the whole fruit, expected at least "
            f"{FEWEST_PHOTOS}, better all. The fruit that drupe found reaches beyond {listed(cut)}. Increase "
            "the distance. If these photos show the whole fruit, drupe took its surroundings for fruit: use "
            "a ground of another colour and even light."
        )
    if len(whole) < given:
        images, cameras = [scene.images[i] for i in whole], [scene.cameras[i] for i in whole]
        scene = replace(scene, images=images, cameras=cameras)
    return scene, np.array(whole, int)


def _overlap(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))
