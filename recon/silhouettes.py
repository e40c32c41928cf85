"""All photos' outlines of the fruit together: plate, odds, coarse carving, and two rounds of projecting
back.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from recon import mask as colour
from recon.camera import Camera
from recon.carve import Block, carve
from recon.failure import ReconFailure, ReconProblem
from recon.hull import Silhouette, drawn, silhouette_of_mask, visual_hull
from recon.mask import Palette, Window
from recon.outline import enlarged, kept_near, outline_of, sharpened, silhouette_of_outline, snapped
from recon.plate import clean_plate

COARSE_SIDE_PX = 300
FINE_SIDE_PX = 480
LOWEST_AGREEMENT = 0.85
FEWEST_VIEWS = 3
PRIOR_ODDS = 4.0
MOST_INWARD_PX = 3.5
ROUNDS = (
    (10.0, 0.15, False, False),
    (6.0, 0.12, False, False),
    (5.0, 0.08, True, False),
    (4.0, 0.05, True, True),
)
DOUBT = 0.03


@dataclass(frozen=True, kw_only=True)
class FoundFruit:
    """The fruit's outlines in the views that agree, their hull, and how far photos and hull agree."""

    silhouettes: tuple[Silhouette, ...]
    used: Int[np.ndarray, " v"]
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    agreement: float
    clear_share: float


@dataclass(frozen=True)
class _View:
    index: int
    window: Window
    camera: Camera
    colours: Float[np.ndarray, "h w 3"]
    difference: Float[np.ndarray, "h w 3"]
    known: Bool[np.ndarray, "h w"]


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
    box = np.stack(np.meshgrid(*zip(low_mm, high_mm, strict=True)), axis=-1).reshape(-1, 3)
    reach = float(np.abs(np.stack([low_mm, high_mm])[:, :2]).max())
    half_width = reach + min(2.5 * float(high_mm[2]), 4 * reach)
    plate = clean_plate(images, cameras, half_width_mm=half_width)
    views = _views(images, cameras, box, plate, margin=0.02, side=COARSE_SIDE_PX)
    odds = [colour.first_odds(v.difference, v.known) for v in views]
    masks = [colour.tidy(o) | ~v.known for o, v in zip(odds, views, strict=True)]
    block = _carved(masks, views, low_mm, high_mm)
    for rim in (0.025, 0.008):
        covered = _covered(
            block.points if rim < 0.02 else block.standing_points, block.cell_mm, images, cameras
        )
        palettes = _palettes(views, odds, block, rim=rim)
        plate = clean_plate(images, cameras, half_width_mm=half_width, covered=covered)
        low, high = block.points.min(0) - 4 * block.cell_mm, block.points.max(0) + 4 * block.cell_mm
        low[2] = max(low[2], low_mm[2])
        views = _views(images, cameras, _corners(low, high), plate, margin=0.12, side=FINE_SIDE_PX)
        odds = _odds(views, palettes, block.standing_points if rim > 0.02 else block.points, block.cell_mm)
        masks = [colour.tidy(o) for o in odds]
        block = _carved(masks, views, low, high)
    centre = block.points.mean(0)
    longest = 2.0 * float(np.linalg.norm(block.points - centre, axis=1).max())
    views, odds, masks = _whole_views(views, odds, masks, block, len(images))
    coarse = [
        silhouette_of_mask(_near(m, block, v), v.window, v.camera) for m, v in zip(masks, views, strict=True)
    ]
    vertices, faces = visual_hull(
        coarse, centre_mm=centre, longest_mm=longest, floor_mm=0.0, level=4, doubt=0.15
    )
    agreement = [
        _overlap(drawn(vertices, faces, v.window, v.camera), m) for v, m in zip(views, masks, strict=True)
    ]
    kept = [i for i, a in enumerate(agreement) if a >= LOWEST_AGREEMENT]
    if len(kept) < FEWEST_VIEWS:
        raise _no_fruit(
            f"the outlines of {len(views)} photos do not fit one body (mean overlap {np.mean(agreement):.2f})"
        )
    views, odds = [views[i] for i in kept], [odds[i] for i in kept]
    silhouettes: list[Silhouette] = [coarse[i] for i in kept]
    clear: list[float] = []
    for reach_px, doubt, keep, sharp in ROUNDS:
        vertices, faces = visual_hull(
            silhouettes, centre_mm=centre, longest_mm=longest, floor_mm=0.0, level=4, doubt=doubt
        )
        silhouettes = []
        for view, odd in zip(views, odds, strict=True):
            expected = outline_of(drawn(vertices, faces, view.window, view.camera))
            if expected is None:
                raise _no_fruit("its outline was lost while it was refined")
            outline, window = snapped(expected, odd, view.colours, reach_px=reach_px), view.window
            if sharp:
                outline, window = sharpened(outline, window)
                expected = enlarged(expected, view.window.shrink)
            if keep:
                outline = kept_near(outline, expected, inward_px=MOST_INWARD_PX)
            if sharp:
                clear.append(outline.clear_share)
            silhouettes.append(silhouette_of_outline(outline, window, view.camera))
    vertices, faces = visual_hull(
        silhouettes, centre_mm=centre, longest_mm=longest, floor_mm=0.0, level=level, doubt=DOUBT
    )
    overlap = [_overlap(drawn(vertices, faces, s.window, s.camera), s.distance_px > 0) for s in silhouettes]
    return FoundFruit(
        silhouettes=tuple(silhouettes),
        used=np.array([v.index for v in views], int),
        vertices=vertices,
        faces=faces,
        agreement=float(np.mean(overlap)),
        clear_share=float(np.mean(clear)),
    )


def _views(images, cameras, box, plate, *, margin: float, side: int) -> list[_View]:  # type: ignore[no-untyped-def]
    views = []
    for i, (image, camera) in enumerate(zip(images, cameras, strict=True)):
        window = colour.window_around(image, camera, box, margin=margin, small_side_px=side)
        if window is None:
            continue
        colours = window.small_lab()
        views.append(
            _View(i, window, camera, colours, *colour.plate_difference(colours, window, plate, camera))
        )
    return views


def _carved(masks: list[Bool[np.ndarray, "h w"]], views: list[_View], low, high) -> Block:  # type: ignore[no-untyped-def]
    block = carve(masks, [v.window for v in views], [v.camera for v in views], low_mm=low, high_mm=high)
    if block.filled.sum() < 300:
        raise _no_fruit("the photos show nothing but the support")
    return block


def _covered(
    points: Float[np.ndarray, "n 3"],
    cell_mm: float,
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
) -> list[Bool[np.ndarray, "h w"]]:
    """Pixels of whole photos that cells at the points may hide."""
    out = []
    for image, camera in zip(images, cameras, strict=True):
        size = cell_mm * camera.focal_px / float(np.median(camera.into(points)[:, 2]))
        at = np.rint(camera.project(points)).astype(int)
        at = at[(at >= 0).all(1) & (at < [camera.width_px, camera.height_px]).all(1)]
        hidden = np.zeros(image.shape[:2], np.uint8)
        hidden[at[:, 1], at[:, 0]] = 1
        reach = 2 * int(1.1 * size + 2) + 1
        out.append(cv2.dilate(hidden, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) > 0)
    return out


def _pixels(points: Float[np.ndarray, "n 3"], cell_mm: float, view: _View) -> Bool[np.ndarray, "h w"]:
    columns, rows = view.window.small_size_px
    at = np.rint(view.window.into_small(view.camera.project(points))).astype(int)
    ok = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows)
    hit = np.zeros((rows, columns), np.uint8)
    hit[at[ok, 1], at[ok, 0]] = 1
    depth = float(view.camera.into(points.mean(0)[None])[0, 2])
    size = int(cell_mm * view.camera.focal_px / depth / view.window.shrink) + 2
    return np.asarray(
        cv2.morphologyEx(hit, cv2.MORPH_CLOSE, np.ones((2 * size + 1, 2 * size + 1), np.uint8)) > 0
    )


def _palettes(
    views: list[_View],
    odds: list[Float[np.ndarray, "h w"]],
    block: Block,
    *,
    rim: float,
) -> dict[int, Palette]:
    """Per view: the fruit's colours in all views, and what lies around it, here as much as elsewhere."""
    fruit, other = [], []
    for view, odd in zip(views, odds, strict=True):
        shadow, standing = (
            _pixels(block.points, block.cell_mm, view),
            _pixels(block.standing_points, block.cell_mm, view),
        )
        side = shadow.shape[0]
        inner = ndimage.binary_erosion(shadow, iterations=max(2, round(rim * side))) & (
            odd > (1 if rim > 0.02 else -2)
        )
        outer = ~ndimage.binary_dilation(standing, iterations=max(3, round(0.04 * side)))
        fruit.append(view.colours[inner][::3])
        other.append(view.colours[outer][::5])
    common = colour.learn_palette(np.concatenate(fruit), np.concatenate(other))
    own = [colour.learn_palette(common_rows, common_rows).other for common_rows in other]
    return {
        v.index: Palette(common.fruit, (common.other + mine) / 2) for v, mine in zip(views, own, strict=True)
    }


def _odds(
    views: list[_View], palettes: dict[int, Palette], cells: Float[np.ndarray, "n 3"], cell_mm: float
) -> list[Float[np.ndarray, "h w"]]:
    """Colour odds, and up to +-PRIOR_ODDS for lying well inside or outside the cells carved before."""
    out = []
    for view in views:
        shadow = _pixels(cells, cell_mm, view)
        noise = colour.difference_noise(
            view.difference, view.known & ~ndimage.binary_dilation(shadow, iterations=10)
        )
        odds = colour.colour_odds(
            view.colours, view.difference, view.known, palettes[view.index], noise=noise
        )
        depth = cv2.distanceTransform(shadow.astype(np.uint8), cv2.DIST_L2, 5)
        depth -= cv2.distanceTransform((~shadow).astype(np.uint8), cv2.DIST_L2, 5)
        out.append(odds + PRIOR_ODDS * np.clip(depth / (0.05 * shadow.shape[0]), -1, 1))
    return out


def _near(found: Bool[np.ndarray, "h w"], block: Block, view: _View) -> Bool[np.ndarray, "h w"]:
    """The part of a mask that the block stands for."""
    shadow = _pixels(block.points, block.cell_mm, view)
    return found & ndimage.binary_dilation(shadow, iterations=max(4, shadow.shape[0] // 20))


def _whole_views(views, odds, masks, block: Block, given: int):  # type: ignore[no-untyped-def]
    """The views whose picture holds the whole block."""
    whole = []
    for i, view in enumerate(views):
        pixels = view.camera.project(block.points)
        inside = (pixels > 3).all(1) & (pixels < [view.camera.width_px - 4, view.camera.height_px - 4]).all(1)
        if inside.all():
            whole.append(i)
    if len(whole) < FEWEST_VIEWS:
        raise ReconFailure(
            ReconProblem.FRUIT_CUT_OFF,
            f"Only {len(whole)} of {given} photos hold the whole fruit; at least {FEWEST_VIEWS} must, all "
            f"should: step back.",
        )
    return [views[i] for i in whole], [odds[i] for i in whole], [masks[i] for i in whole]


def _overlap(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def _corners(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 3"]:
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)


def _no_fruit(fault: str) -> ReconFailure:
    return ReconFailure(
        ReconProblem.NO_FRUIT,
        f"No fruit found: {fault}; expected one fruit in the blank centre, seen from all around: check the "
        f"photos.",
    )
