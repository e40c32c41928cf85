"""Segmentation: log odds of pixels, masks of photos, and a first coarse block of cells by vote."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from recon.cameras.camera import Camera
from recon.learned.fruit_model import FruitModel
from recon.picture_values import Pictures
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes import mask as colour
from recon.silhouettes.background_plate import (
    FEWEST_VIEWS,
    BackgroundPlate,
    GroundViews,
    background_plate,
    ground_views,
)
from recon.silhouettes.mask import Behind, Window
from recon.silhouettes.star_cut import star_cuts

CELLS = 44
"""Cells along the longest side of the box: enough for a first place and size. Set by hand."""
AGREEMENT = 0.85
"""Share of the views that must not classify a cell as ground: some may err. Set by hand."""
LEAST_SUPPORT = 0.4
"""Least share of the views that must classify a cell as fruit, whatever others know. Set by hand."""


@dataclass(frozen=True)
class Block:
    """Cells of a box that are fruit: `filled[i, j, k]` at `low + (i + ½, j + ½, k + ½) cell`."""

    filled: Bool[np.ndarray, "a b c"]
    low_mm: Float[np.ndarray, "3"]
    cell_mm: float

    @property
    def points(self) -> Float[np.ndarray, "n 3"]:
        """Centres of the filled cells."""
        return np.asarray(self.low_mm + (np.argwhere(self.filled) + 0.5) * self.cell_mm)

    def with_column(self, *, reach: int) -> "Block":
        """This block dilated by `reach` cells, with everything straight below it, down to the box's floor."""
        wide = np.pad(self.filled, ((reach, reach), (reach, reach), (0, reach)))
        grown = ndimage.binary_dilation(wide, ndimage.generate_binary_structure(3, 1), iterations=reach)
        grown = np.flip(np.logical_or.accumulate(np.flip(grown, axis=2), axis=2), axis=2)
        low = self.low_mm - reach * self.cell_mm * np.array([1, 1, 0])
        return Block(np.asarray(grown), low, self.cell_mm)


def carve(
    masks: Sequence[Bool[np.ndarray, "_ _"]],
    known: Sequence[Bool[np.ndarray, "_ _"]],
    windows: Sequence[Window],
    cameras: Sequence[Camera],
    *,
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
    agreement: float = AGREEMENT,
) -> Block:
    """The largest connected set of cells that few views call ground and enough views call fruit.

    At pixels of `known` a view votes for fruit inside its mask, and otherwise for ground. At other pixels it
    does not vote. A share 1 - `agreement` of the views that show a cell may call it ground. LEAST_SUPPORT of
    all views must call it fruit. Voting, unlike strict intersection, keeps fruit that one bad mask misses.
    """
    cell = float((high_mm - low_mm).max()) / CELLS
    shape = np.maximum(np.ceil((high_mm - low_mm) / cell).astype(int), 1)
    centres = low_mm + (np.indices(shape).reshape(3, -1).T + 0.5) * cell
    shown, fruit, ground = np.zeros((3, len(centres)))
    for mask, there, window, camera in zip(masks, known, windows, cameras, strict=True):
        at = np.rint(window.into_small(camera.project(centres))).astype(int)
        ok = (at >= 0).all(1) & (at[:, 0] < mask.shape[1]) & (at[:, 1] < mask.shape[0])
        column, row = at[ok].T
        shown += ok
        fruit[ok] += there[row, column] & mask[row, column]
        ground[ok] += there[row, column] & ~mask[row, column]
    votes = shown - ground >= agreement * shown
    votes &= fruit >= max(FEWEST_VIEWS, LEAST_SUPPORT * len(cameras))
    parts, count = ndimage.label(votes.reshape(shape))
    if count == 0:
        return Block(np.zeros(shape, bool), low_mm, cell)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    filled = ndimage.binary_fill_holes(parts == sizes.argmax())
    return Block(np.asarray(filled), low_mm, cell)


COARSE_SIDE_PX = 300
"""Side of a shrunk window for the first block, px, whose cells are a few pixels wide there."""
SURE_LOG_ODDS = 2.0
"""Log odds above which a pixel certainly differs from the plate: 7 to 1. Set by hand."""
FEWEST_CELLS = 60
"""Least number of cells of the first block: fewer are a speck. Set by hand."""
CORE_SHARE = 0.4
"""Half side of the box's core, over the box's, whose pixels give the fruit's colours. Set by hand."""
FEWEST_SURE_PIXELS = 500
"""Least number of pixels for a palette: fewer do not fill its bins. Set by hand."""
PRIOR_LOG_ODDS, PRIOR_SHARE = 8.0, 0.03
"""Prior log odds of pixels that must or cannot be fruit by the other photos; width of their ramp over the
side. Set by hand; above MOST_LOG_ODDS of recon.silhouettes.mask, so that colour does not outvote them."""
UNKNOWN_LOG_ODDS = (-0.3, 0.5)
"""Bounds of colour's log odds where the plate is unknown: colour steps decide there. With (0.2, 0.8) possible
fruit included the shadow under a dull peach (set 8 of benchmarks/photo_bank.py: 4.3 mm off)."""
BLURRED_LOG_ODDS, MOST_LEARNED_LOG_ODDS = 2.0, 4.0
"""The fruit model's log odds are reduced by the first (its edge is blurred), and are at most the second. In
full, they gave 0.46 instead of 0.41 mm of error on 18 photos of a nectarine (outlines alone)."""
THINNED = 2
"""Step between pixels and rows for statistics of the ground: tens of thousands of pixels suffice."""


@dataclass(frozen=True)
class CutPhoto:
    """A photo's window: Lab colours, their cells in a histogram, the fruit model's log odds (or 0)."""

    index: int
    window: Window
    camera: Camera
    colours: Float[np.ndarray, "h w 3"]
    cells: Int[np.ndarray, "h w"]
    learned: Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class Bounds:
    """Pixels of a view's shrunk window that are certainly fruit, and that may be fruit."""

    sure: Bool[np.ndarray, "h w"]
    perhaps: Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class SegmentationScene:
    """Undistorted photos of a fruit on the plane z = 0, a box (mm) that contains it, and the fruit model, or
    None.
    """

    images: Pictures
    cameras: Sequence[Camera]
    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]
    model: FruitModel | None = None

    @cached_property
    def ground(self) -> GroundViews:
        """The plane under and around the box as the photos show it."""
        reach = float(np.abs(np.stack([self.low_mm, self.high_mm])[:, :2]).max())
        half_width = reach + min(2.5 * float(self.high_mm[2]), 4 * reach)
        return ground_views(self.images, self.cameras, half_width_mm=half_width)

    def background(self, covered: Sequence[Bool[np.ndarray, "_ _"]] | None) -> BackgroundPlate:
        """The ground without the fruit, which hides the pixels of the photos that `covered` marks."""
        return background_plate(self.ground, covered)

    def views(self, around: Float[np.ndarray, "n 3"], *, margin: float, side_px: int) -> list[CutPhoto]:
        """The photos' windows around some points, about `side_px` wide once shrunk."""
        windows = {}
        for i, (image, camera) in enumerate(zip(self.images, self.cameras, strict=True)):
            window = colour.window_around(image, camera, around, margin=margin, small_side_px=side_px)
            if window is not None:
                windows[i] = window
        views = []
        for (i, window), learned in zip(windows.items(), self._learned(windows), strict=True):
            colours = window.small_lab()
            views.append(CutPhoto(i, window, self.cameras[i], colours, colour.cells_of(colours), learned))
        return views

    def _learned(self, windows: dict[int, Window]) -> list[Float[np.ndarray, "_ _"]]:
        """Log odds that the fruit model adds in each window."""
        if self.model is None or not windows:
            return [np.zeros(w.small_size_px[::-1], np.float32) for w in windows.values()]
        log_odds = self.model.log_odds([self.images[i] for i in windows], list(windows.values()))
        clear = [x - np.clip(x, -BLURRED_LOG_ODDS, BLURRED_LOG_ODDS) for x in log_odds]
        return [np.clip(x, -MOST_LEARNED_LOG_ODDS, MOST_LEARNED_LOG_ODDS) for x in clear]


def first_block(scene: SegmentationScene, *, agreement: float = AGREEMENT) -> Block:
    """The object on z = 0 inside the box, as coarse cells; its shaded lower flank may be missing.

    The plate is the median over the photos, which must outvote the fruit. Where it is not known and the fruit
    model does not decide, a photo does not vote. `agreement`: see `carve`. Raises ReconFailure (no-fruit) for
    fewer than FEWEST_CELLS.
    """
    corners = np.stack(np.meshgrid(*zip(scene.low_mm, scene.high_mm, strict=True)), axis=-1).reshape(-1, 3)
    views = scene.views(corners, margin=0.02, side_px=COARSE_SIDE_PX)
    background = scene.background(None)
    scatter = colour.background_scatter(background)
    log_odds, known, masks = [], [], []
    for view in views:
        behind = colour.ground_behind(view.window, background, scatter, view.camera)
        log_odds.append(colour.first_log_odds(view.colours, behind) + view.learned)
        known.append(behind.known | (view.learned != 0))
        masks.append(colour.tidy(log_odds[-1]))
    try:
        return _carved(masks, known, views, scene, agreement)
    except ReconFailure:
        similar = _similar_to_fruit(views, log_odds, known, scene.low_mm, scene.high_mm)
        masks = [m | a for m, a in zip(masks, similar, strict=True)]
        return _carved(masks, known, views, scene, agreement)


def _similar_to_fruit(
    views: list[CutPhoto],
    log_odds: list[Float[np.ndarray, "_ _"]],
    known: list[Bool[np.ndarray, "_ _"]],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
) -> list[Bool[np.ndarray, "_ _"]]:
    """Pixels with colours similar to the fruit's, though the plate may have them too: dark skin on black ink.

    They count as fruit if no fruit is found without them. The fruit's colours are those of pixels that
    certainly differ from the plate, in the projection of the box's core.
    """
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 9)] * 3), axis=-1).reshape(-1, 3)
    middle, half = (low + high) / 2, (high - low) / 2
    core = middle + grid * half * CORE_SHARE
    core[:, 2] = low[2] + (grid[:, 2] + 1.3) * CORE_SHARE * half[0]
    sure = []
    for view, evidence, there in zip(views, log_odds, known, strict=True):
        columns, rows = view.window.small_size_px
        hull = cv2.convexHull(view.window.into_small(view.camera.project(core)).astype(np.float32))
        inside = np.zeros((rows, columns), np.uint8)
        cv2.fillConvexPoly(inside, np.rint(hull).astype(np.int32), 1)
        sure.append(view.colours[(inside > 0) & (evidence > SURE_LOG_ODDS) & there])
    pixels = np.concatenate(sure)
    if len(pixels) < FEWEST_SURE_PIXELS:
        return [np.zeros_like(there) for there in known]
    return [colour.looks_like(v.colours, pixels) & there for v, there in zip(views, known, strict=True)]


def _carved(
    masks: list[Bool[np.ndarray, "_ _"]],
    known: list[Bool[np.ndarray, "_ _"]],
    views: list[CutPhoto],
    scene: SegmentationScene,
    agreement: float,
) -> Block:
    """The coarse fruit that the masks agree on; raises ReconFailure (no-fruit) without one."""
    windows, cameras = [v.window for v in views], [v.camera for v in views]
    block = carve(
        masks, known, windows, cameras, low_mm=scene.low_mm, high_mm=scene.high_mm, agreement=agreement
    )
    if block.filled.sum() < FEWEST_CELLS:
        raise no_fruit("the photos show only the support")
    return block


def learned_log_odds(
    views: Sequence[CutPhoto],
    bounds: Sequence[Bounds],
    background: BackgroundPlate,
    centre_mm: Float[np.ndarray, "3"],
) -> tuple[list[Float[np.ndarray, "_ _"]], list[Bool[np.ndarray, "_ _"]]]:
    """Log odds of fruit against ground in every view, and the mask that they make.

    The fruit's colours come from certain fruit, half from this view and half from all, the ground's from
    certain ground. (Colours learned again inside the masks included a glossy cherry's shadow.) Outside of
    possible fruit the odds are against it. `centre_mm` is about the fruit's middle.
    """
    ground = []
    for bound in bounds:
        size = 2 * max(3, round(0.02 * len(bound.perhaps))) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        ground.append(cv2.dilate(bound.perhaps.astype(np.uint8), disc) == 0)
    around = colour.colour_density(
        np.concatenate([v.cells[m][::5] for v, m in zip(views, ground, strict=True)])
    )
    scatter = colour.background_scatter(background)
    inside = [v.cells[b.sure] for v, b in zip(views, bounds, strict=True)]
    fruit_of_all = colour.colour_density(np.concatenate([c[::3] for c in inside]))
    log_odds = [
        _log_odds(
            view,
            bound,
            out,
            colour.ground_behind(view.window, background, scatter, view.camera),
            around,
            (fruit_of_all + colour.colour_density(cells)) / 2,
        )
        for view, bound, out, cells in zip(views, bounds, ground, inside, strict=True)
    ]
    centres = [v.window.into_small(v.camera.project(centre_mm[None]))[0] for v in views]
    masks = star_cuts(log_odds, [v.colours for v in views], centres)
    return log_odds, masks


def _log_odds(
    view: CutPhoto,
    bound: Bounds,
    ground: Bool[np.ndarray, "h w"],
    behind: Behind,
    around: Float[np.ndarray, " c"],
    fruit: Float[np.ndarray, " c"],
) -> Float[np.ndarray, "h w"]:
    """Log odds of one view. Colours count where the prior is open. Noise and the share of strange pixels are
    estimated on every THINNED-th pixel and line.
    """
    thin = (slice(None, None, THINNED), slice(None, None, THINNED))
    colours, cells, few, out = view.colours[thin], view.cells[thin], behind.at(thin), ground[thin]
    noise = colour.ground_noise(colours, few, out)
    palette = 0.1 * around + 0.9 * colour.colour_density(cells[out])
    strange = colour.strange_share(colour.ground_density(colours, few, noise), palette[cells], out)
    strange = cv2.resize(strange, ground.shape[::-1], interpolation=cv2.INTER_LINEAR)
    strange = np.where(behind.known, strange, np.maximum(strange, 0.5))
    prior = _prior(bound)
    open_ = np.nonzero(np.abs(prior) < PRIOR_LOG_ODDS)
    on_background = colour.ground_density(view.colours[open_], behind.at(open_), noise)
    cells = view.cells[open_]
    by_colour = colour.colour_log_odds(fruit[cells], on_background, palette[cells], strange[open_])
    log_odds = prior + view.learned
    log_odds[open_] += np.where(behind.known[open_], by_colour, np.clip(by_colour, *UNKNOWN_LOG_ODDS))
    return np.asarray(log_odds)


def _prior(bound: Bounds) -> Float[np.ndarray, "h w"]:
    """Log odds for certain fruit, against impossible fruit; each ramps over PRIOR_SHARE of the side."""
    width = PRIOR_SHARE * len(bound.sure)
    outside = cv2.distanceTransform((~bound.perhaps).astype(np.uint8), cv2.DIST_L2, 3)
    inside = cv2.distanceTransform(bound.sure.astype(np.uint8), cv2.DIST_L2, 3)
    prior = PRIOR_LOG_ODDS * (np.clip(inside / width, 0, 1) - np.clip(outside / width, 0, 1))
    return np.asarray(prior, np.float32)


def pixels_of(block: Block, window: Window, camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Mask of the block's projection in a camera's shrunk window."""
    columns, rows = window.small_size_px
    points = block.points
    at = np.rint(window.into_small(camera.project(points))).astype(int)
    ok = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows)
    hit = np.zeros((rows, columns), np.uint8)
    hit[at[ok, 1], at[ok, 0]] = 1
    depth = float(camera.into(points.mean(0)[None])[0, 2])
    size = int(block.cell_mm * camera.focal_px / depth / window.shrink) + 2
    return np.asarray(
        cv2.morphologyEx(hit, cv2.MORPH_CLOSE, np.ones((2 * size + 1, 2 * size + 1), np.uint8)) > 0
    )


def eroded(mask: Bool[np.ndarray, "h w"], by_px: float) -> Bool[np.ndarray, "h w"]:
    """Pixels deeper inside the mask than `by_px` (at least two)."""
    inside = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    return np.asarray(inside > max(2.0, by_px))


def no_fruit(fault: str) -> ReconFailure:
    """The failure (no-fruit) and its reason."""
    return ReconProblem.NO_FRUIT.failure(
        f"drupe found no fruit: {fault}; expected one fruit in the blank centre, visible from all "
        "sides. Check the photos."
    )
