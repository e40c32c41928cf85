"""Which cells and pixels are fruit: the clean plate, the odds of each pixel, and a block carved by vote,
thrice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from recon import mask as colour
from recon.camera import Camera
from recon.carve import Block, carve
from recon.failure import ReconFailure, ReconProblem
from recon.mask import Palette, Window
from recon.plate import Plate, clean_plate

COARSE_SIDE_PX = 300
FINE_SIDE_PX = 480
PRIOR_ODDS = 4.0
FEWEST_CELLS = 60
CORE_SHARE = 0.4
SURE_ODDS = 2.0
FEWEST_SURE_PIXELS = 500


@dataclass(frozen=True)
class View:
    """A photo's window around the fruit: Lab colours, their difference to the plate, and where that is
    known.
    """

    index: int
    window: Window
    camera: Camera
    colours: Float[np.ndarray, "h w 3"]
    difference: Float[np.ndarray, "h w 3"]
    known: Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class Segmented:
    """Views, the log odds and the mask of each, and the block of cells that nearly all masks agree on."""

    views: list[View]
    odds: list[Float[np.ndarray, "h w"]]
    masks: list[Bool[np.ndarray, "h w"]]
    block: Block

    def only(self, which: Sequence[int]) -> "Segmented":
        """Some of the views."""
        return Segmented(
            [self.views[i] for i in which],
            [self.odds[i] for i in which],
            [self.masks[i] for i in which],
            self.block,
        )


def segmented(
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    *,
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
) -> Segmented:
    """The thing that stands on z = 0 inside a box, pixel by pixel.

    A first plate (the fruit outvoted) gives a first block; from it come the fruit's colours and a plate
    without the fruit, from these a better block, and once more. Raises ReconFailure (no-fruit) where nothing
    stands there.
    """
    reach = float(np.abs(np.stack([low_mm, high_mm])[:, :2]).max())
    half_width = reach + min(2.5 * float(high_mm[2]), 4 * reach)
    plate = clean_plate(images, cameras, half_width_mm=half_width)
    views = _views(images, cameras, _corners(low_mm, high_mm), plate, margin=0.02, side=COARSE_SIDE_PX)
    odds = [colour.first_odds(v.difference, v.known) for v in views]
    masks = [colour.tidy(o) | ~v.known for o, v in zip(odds, views, strict=True)]
    try:
        block = _carved(masks, views, low_mm, high_mm)
    except ReconFailure:
        alike = _alike(views, odds, low_mm, high_mm)
        block = _carved([m | a for m, a in zip(masks, alike, strict=True)], views, low_mm, high_mm)
    for first in (True, False):
        cells = block.standing_points if first else block.points
        palettes = _palettes(views, odds, block, first=first)
        covered = _covered(cells, block.cell_mm, images, cameras)
        plate = clean_plate(images, cameras, half_width_mm=half_width, covered=covered)
        low, high = block.points.min(0) - 4 * block.cell_mm, block.points.max(0) + 4 * block.cell_mm
        low[2] = max(low[2], low_mm[2])
        views = _views(images, cameras, _corners(low, high), plate, margin=0.12, side=FINE_SIDE_PX)
        odds = _odds(views, palettes, cells, block.cell_mm)
        masks = [colour.tidy(o) for o in odds]
        block = _carved(masks, views, low, high)
    return Segmented(views, odds, masks, block)


def block_pixels(block: Block, view: View) -> Bool[np.ndarray, "h w"]:
    """The block's shadow in a view's shrunk window."""
    return _pixels(block.points, block.cell_mm, view)


def _views(
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    box: Float[np.ndarray, "8 3"],
    plate: Plate,
    *,
    margin: float,
    side: int,
) -> list[View]:
    views = []
    for i, (image, camera) in enumerate(zip(images, cameras, strict=True)):
        window = colour.window_around(image, camera, box, margin=margin, small_side_px=side)
        if window is None:
            continue
        colours = window.small_lab()
        views.append(
            View(i, window, camera, colours, *colour.plate_difference(colours, window, plate, camera))
        )
    return views


def _alike(
    views: list[View],
    odds: list[Float[np.ndarray, "h w"]],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
) -> list[Bool[np.ndarray, "h w"]]:
    """Pixels that look like the plate behind them but also like the fruit: dark skin before black ink.

    They say nothing against a fruit, where it is not found without them. The fruit's colours are those of
    pixels surely unlike the plate, where the middle of the box projects to.
    """
    x, y, z = (np.linspace(-s, s, 9) for s in (1.0, 1.0, 1.0))
    grid = np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)
    middle, half = (low + high) / 2, (high - low) / 2
    core = middle + grid * half * CORE_SHARE
    core[:, 2] = low[2] + (grid[:, 2] + 1.3) * CORE_SHARE * half[0]
    sure = []
    for view, odd in zip(views, odds, strict=True):
        columns, rows = view.window.small_size_px
        hull = cv2.convexHull(view.window.into_small(view.camera.project(core)).astype(np.float32))
        inside = np.zeros((rows, columns), np.uint8)
        cv2.fillConvexPoly(inside, np.rint(hull).astype(np.int32), 1)
        sure.append(view.colours[(inside > 0) & (odd > SURE_ODDS) & view.known])
    pixels = np.concatenate(sure)
    if len(pixels) < FEWEST_SURE_PIXELS:
        return [np.zeros_like(v.known) for v in views]
    return [colour.looks_like(v.colours, pixels) & v.known for v in views]


def _carved(
    masks: list[Bool[np.ndarray, "h w"]],
    views: list[View],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
) -> Block:
    """The coarse fruit that the masks agree on, or the failure that there is none."""
    block = carve(masks, [v.window for v in views], [v.camera for v in views], low_mm=low, high_mm=high)
    if block.filled.sum() < FEWEST_CELLS:
        raise no_fruit("the photos show nothing but the support")
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


def _pixels(points: Float[np.ndarray, "n 3"], cell_mm: float, view: View) -> Bool[np.ndarray, "h w"]:
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
    views: list[View],
    odds: list[Float[np.ndarray, "h w"]],
    block: Block,
    *,
    first: bool,
) -> dict[int, Palette]:
    """Per view: the fruit's colours in all views, and what lies around it, here as much as elsewhere."""
    fruit, other = [], []
    for view, odd in zip(views, odds, strict=True):
        shadow, standing = (
            _pixels(block.points, block.cell_mm, view),
            _pixels(block.standing_points, block.cell_mm, view),
        )
        side = shadow.shape[0]
        inner = ndimage.binary_erosion(
            shadow, iterations=max(2, round((0.025 if first else 0.008) * side))
        ) & (odd > (1 if first else -2))
        outer = ~ndimage.binary_dilation(standing, iterations=max(3, round(0.04 * side)))
        fruit.append(view.colours[inner][::3])
        other.append(view.colours[outer][::5])
    common = colour.learn_palette(np.concatenate(fruit), np.concatenate(other))
    own = [colour.learn_palette(common_rows, common_rows).other for common_rows in other]
    return {
        v.index: Palette(common.fruit, (common.other + mine) / 2) for v, mine in zip(views, own, strict=True)
    }


def _odds(
    views: list[View], palettes: dict[int, Palette], cells: Float[np.ndarray, "n 3"], cell_mm: float
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


def _corners(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 3"]:
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)


def no_fruit(fault: str) -> ReconFailure:
    """The failure that there is no fruit, and why it is thought so."""
    return ReconFailure(
        ReconProblem.NO_FRUIT,
        f"No fruit found: {fault}; expected one fruit in the blank centre, seen from all around: check the "
        f"photos.",
    )
