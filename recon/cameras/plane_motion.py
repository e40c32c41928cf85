"""Cameras without a mat, from the flat ground under the fruit in few, widely spaced photos."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from pipeline.files.plain_file import listed
from recon.cameras.camera import Camera, aim_of, middle_of, pinhole, place_of, straightened
from recon.cameras.ground_plane import upright
from recon.cameras.mat_poses import Poses
from recon.cameras.photos import FEWEST_PHOTOS, Photo
from recon.cameras.plane_bundle import RIGID, Adjusted, PlaneScene, Sightings, adjusted, projected
from recon.cameras.plane_start import (
    KNOWN_FOCAL_SD,
    USUAL_FOCAL,
    USUAL_FOCAL_SD,
    GroundPair,
    chained,
    ground_features,
    ground_pairs,
    joined,
    start_cameras,
)
from recon.cameras.similarity import affine, scaling
from recon.cameras.view_plan import missing_views
from recon.learned.fruit_model import FruitModel
from recon.picture_values import sampled
from recon.recon_failure import ReconFailure, ReconProblem
from recon.scale import Box, box_about_z
from recon.silhouettes.segmentation import SegmentationScene, first_block

SIDE_PX = 1000
"""Side of the top view, px: about as fine as the photos show the ground. Set by hand."""
REACH = 0.6
"""Half side of the top view, over the median distance of the cameras."""
EVEN_PX = 12.0
"""Scale, px, of local brightness normalisation, which removes shadows and the phone's tone curve."""
PATCH_PX = 10
"""Half side of a patch, px: 441 pixels determine a correlation to a few hundredths."""
MOST_CORNERS = 700
"""Most corners: more cost time and do not change the cameras. Set by hand."""
LEAST_APART_PX = 9
"""Least distance between points, px: patches overlap by about half."""
LEAST_LIKE = 0.5
"""Least correlation of a matched patch."""
FLOOR_PX = 0.05
"""Error of the parabola through the correlation, without noise, px."""
FEWEST_VIEWS = 3
"""Least number of photos that show a point of the median ground."""


def _from_above(
    photo: Photo, scene: PlaneScene, view: int, grid: Float[np.ndarray, "n 2"], side: int
) -> tuple[Float[np.ndarray, "s s"], Bool[np.ndarray, "s s"]]:
    """A photo's top view of the ground with normalised brightness, and the mask of its visible part."""
    grey = cv2.cvtColor(photo.image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    height, width = grey.shape
    at = projected(scene, np.full(len(grid), view), grid, middle_of(grey.shape))
    pose = scene.poses[view]
    ahead = grid @ pose[2, :2] + pose[2, 3] > 0
    inside = ahead & (at > 2).all(1) & (at < [width - 3, height - 3]).all(1)
    at = np.where(inside[:, None], at, -10).reshape(side, side, 2)
    seen = sampled(grey, at, outside=0.0)
    shown = inside.reshape(side, side).astype(np.float32)
    share = cv2.GaussianBlur(shown, (0, 0), EVEN_PX) + 1e-3
    mean = cv2.GaussianBlur(seen * shown, (0, 0), EVEN_PX) / share
    off = (seen - mean) * shown
    spread = np.sqrt(cv2.GaussianBlur(off * off, (0, 0), EVEN_PX) / share)
    return off / (spread + 2.0), inside.reshape(side, side)


def ground_tracks(
    photos: Sequence[Photo], scene: PlaneScene, foot: Float[np.ndarray, "2"], *, search_px: int
) -> tuple[Sightings, Float[np.ndarray, "n 2"]]:
    """Sightings of ground points around `foot`, and the points.

    The median of all top views shows the ground without the fruit. Patches at its corners (Shi, Tomasi 1994)
    are searched in each photo by normalised cross-correlation, within `search_px` picture elements.
    """
    distance = float(np.median([np.linalg.norm(place_of(p) - [*foot, 0.0]) for p in scene.poses]))
    side = SIDE_PX
    unit = 2 * REACH * distance / side
    y, x = np.mgrid[:side, :side].astype(float)
    grid = np.stack([x.ravel(), y.ravel()], 1) * unit + foot - REACH * distance
    pictures, shown = zip(
        *(_from_above(photo, scene, i, grid, side) for i, photo in enumerate(photos)), strict=True
    )
    median_picture = _median(pictures, shown)
    common = np.sum(shown, axis=0) >= FEWEST_VIEWS
    border = np.zeros_like(common)
    edge = PATCH_PX + search_px + 2
    border[edge:-edge, edge:-edge] = True
    corners = cv2.goodFeaturesToTrack(
        median_picture,
        MOST_CORNERS,
        0.01,
        LEAST_APART_PX,
        mask=(common & border).astype(np.uint8),
        blockSize=9,
    )
    corners = np.empty((0, 2), int) if corners is None else np.rint(corners[:, 0]).astype(int)
    views, points, places, spreads = [], [], [], []
    for i, (picture, inside) in enumerate(zip(pictures, shown, strict=True)):
        moved, matched, spread = _searched(median_picture, picture, inside, corners, search_px)
        at = (corners[matched] + moved[matched]) * unit + foot - REACH * distance
        middle = middle_of(photos[i].image.shape)
        views.append(np.full(len(at), i))
        points.append(np.flatnonzero(matched))
        places.append(projected(scene, views[-1], at, middle))
        steps = [projected(scene, views[-1], at + unit * e, middle) - places[-1] for e in np.eye(2)]
        px_from_element = np.stack(steps, axis=2)
        spreads.append(px_from_element @ spread[matched] @ np.swapaxes(px_from_element, 1, 2))
    W = np.linalg.inv(np.linalg.cholesky(np.concatenate(spreads)))  # scaled below, to median 1
    seen = Sightings(
        np.concatenate(views),
        np.concatenate(points),
        np.concatenate(places),
        W / np.median(np.sqrt(np.abs(np.linalg.det(W)))) if len(W) else W,
    )
    return compacted(seen, corners * unit + foot - REACH * distance)


def compacted(
    seen: Sightings, ground: Float[np.ndarray, "n 2"]
) -> tuple[Sightings, Float[np.ndarray, "m 2"]]:
    """Sightings and ground without the points that fewer than FEWEST_VIEWS photos show."""
    often = np.bincount(seen.point, minlength=len(ground)) >= FEWEST_VIEWS
    number = np.cumsum(often) - 1
    kept = seen.kept(often[seen.point])
    return Sightings(kept.view, number[kept.point], kept.places_px, kept.whiten), ground[often]


def _median(
    pictures: Sequence[Float[np.ndarray, "s s"]], shown: Sequence[Bool[np.ndarray, "s s"]]
) -> Float[np.ndarray, "s s"]:
    out = np.zeros_like(pictures[0])
    for top in range(0, len(out), 100):
        rows = slice(top, top + 100)
        stack = np.stack([np.where(s[rows], p[rows], np.inf) for p, s in zip(pictures, shown, strict=True)])
        stack.sort(axis=0)
        count = np.isfinite(stack).sum(0)
        ranks = np.maximum([(count - 1) // 2, count // 2], 0)
        out[rows] = np.where(count > 0, np.take_along_axis(stack, ranks, 0).mean(0), 0)
    return out.astype(np.float32)


def _searched(
    median_picture: Float[np.ndarray, "s s"],
    picture: Float[np.ndarray, "s s"],
    inside: Bool[np.ndarray, "s s"],
    corners: np.ndarray,
    search_px: int,
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"], Float[np.ndarray, "n 2 2"]]:
    """Offset of each corner's patch in a picture, whether it was found there, and the covariance.

    Near its peak the correlation is c - x' A x / 2. Noise moves the peak with the covariance A^-1 (1 - c) /
    n, n the patch's area over a blur's; FLOOR_PX is added in all directions.
    """
    spread = np.tile(np.eye(2), (len(corners), 1, 1))
    moved, matched = np.zeros((len(corners), 2)), np.zeros(len(corners), bool)
    reach = PATCH_PX + search_px
    for k, (x, y) in enumerate(corners.tolist()):
        rows, columns = slice(y - reach, y + reach + 1), slice(x - reach, x + reach + 1)
        if not inside[rows, columns].all():
            continue
        patch = median_picture[y - PATCH_PX : y + PATCH_PX + 1, x - PATCH_PX : x + PATCH_PX + 1]
        like = cv2.matchTemplate(picture[rows, columns], patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, (u, v) = cv2.minMaxLoc(like)
        if best < LEAST_LIKE or not (0 < u < 2 * search_px and 0 < v < 2 * search_px):
            continue
        top = _top(like[v - 1 : v + 2, u - 1 : u + 2].astype(float))
        if top is None:
            continue
        moved[k], matched[k] = np.array([u, v]) - search_px + top[0], True
        noise = max(1.0 - best, 0.01) / (PATCH_PX * PATCH_PX)
        spread[k] = noise * np.linalg.inv(top[1]) + FLOOR_PX**2 * np.eye(2)
    return moved, matched, spread


def _top(like: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]] | None:
    """Peak and curvature A of the quadratic fitted to 3 x 3 values; None without a peak within a pixel."""
    gx = (like[:, 2].sum() - like[:, 0].sum()) / 6
    gy = (like[2].sum() - like[0].sum()) / 6
    xx = (like[:, 0].sum() + like[:, 2].sum() - 2 * like[:, 1].sum()) / 3
    yy = (like[0].sum() + like[2].sum() - 2 * like[1].sum()) / 3
    xy = (like[0, 0] + like[2, 2] - like[0, 2] - like[2, 0]) / 4
    A = np.array([[xx, xy], [xy, yy]])
    if not (xx < 0 and np.linalg.det(A) > 0):
        return None
    step = -np.linalg.solve(A, [gx, gy])
    return (step, -A) if np.abs(step).max() < 1 else None


FEWER_FEATURES, MORE_FEATURES = 700, 1600
"""Features of each top view at first, and if photos stay unconnected; time grows with the square."""
MOST_POINTS = 2500
"""Most points of the first adjustment, over all photos: bounds its time. Set by hand."""
START_LOSS_PX, LOSS_PX = 4.0, 1.0
"""Scale of Cauchy's loss, px, while cameras are rough and at the end. Set by hand."""
SEARCHES_PX = (10, 4, 3)
"""Range, in elements of the top view, of the search for points in each round, as cameras improve."""
FEWEST_TRACKS = 30
"""Least number of ground points for a set of cameras. Set by hand."""
MOST_MISS_PX = 1.5
"""Median residual, px, above which ground points do not lie on one plane."""


def cameras_from_ground(
    photos: Sequence[Photo], *, height_mm: float, model: FruitModel | None = None
) -> Poses:
    """Cameras from the ground's texture, matched in top views, on the plane z = 0.

    Homographies of the ground between all pairs give focal length and poses. Patches of the ground in every
    photo then refine them; each photo's focal length may deviate from the common one. World and box as in
    recon.cameras.motion. Raises ReconFailure: no-fruit, no-overlap (sizes differ, ground not flat, or under
    three photos, or half, or not the first, are connected).
    """
    if len({p.image.shape for p in photos}) != 1:
        raise ReconProblem.NO_OVERLAP.failure(
            "The photos differ in size; use one camera, one zoom setting and one orientation for all photos."
        )
    pairs = ground_pairs([ground_features(p, most=FEWER_FEATURES) for p in photos])
    members = joined(pairs, len(photos))[0]
    if len(members) < len(photos):
        pairs = ground_pairs([ground_features(p, most=MORE_FEATURES) for p in photos])
        members = joined(pairs, len(photos))[0]
    size = (photos[0].image.shape[0], photos[0].image.shape[1])
    known = [p.focal_px for p in photos if p.focal_px is not None]
    focal_px = float(np.median(known)) if known else None
    if len(members) < max(FEWEST_PHOTOS, len(photos) / 2) or 0 not in members:
        raise _apart(photos, members, pairs, size, focal_px)
    adjustment = _refined(
        [photos[i] for i in members], _started(pairs, members, size, focal_px), size, focal_px
    )
    scene, seen = adjustment.scene, [photos[m] for m in members]
    foot = aim_of(scene.poses) * [1.0, 1.0, 0.0]
    level = upright(np.array([0.0, 0.0, 1.0]), foot, place_of(scene.poses[0]) - foot)
    cameras = [
        Camera.of(photo, focal_px, scene.k1, pose).moved(level)
        for photo, focal_px, pose in zip(seen, scene.focals_px, scene.poses, strict=True)
    ]
    world, box = placed(seen, cameras, height_mm, model)
    lost = len(photos) - len(members)
    lacking = _lacking(photos, members, [c.place for c in cameras], np.zeros(3))
    return Poses(
        cameras=tuple(c.moved(world) for c in cameras),
        used=np.array(members, int),
        reprojection_px=float(np.median(adjustment.miss_px)),
        scale_sd=float("inf"),
        focal_sd_px=adjustment.focal_sd * cameras[0].focal_px,
        box=box,
        warnings=(f"drupe found no camera pose for {lost} of {len(photos)} photos. {lacking}",)
        if lost
        else (),
    )


def _lacking(
    photos: Sequence[Photo],
    members: Sequence[int],
    places: Sequence[Float[np.ndarray, "3"]],
    middle: Float[np.ndarray, "3"],
) -> str:
    """Missing views, in words, if the photos `members` were taken at `places` around the middle."""
    names = [p.name for p in photos]
    unplaced = [name for i, name in enumerate(names) if i not in members]
    return missing_views(
        [names[i] for i in members], np.array(places), middle, given=names, unplaced=unplaced
    )


def _apart(
    photos: Sequence[Photo],
    largest: Sequence[int],
    pairs: Sequence[GroundPair],
    size: tuple[int, int],
    focal_px: float | None,
) -> ReconFailure:
    """The failure (no-overlap) that names the connected photos and where more are needed."""
    if len(largest) < FEWEST_PHOTOS:
        return ReconProblem.NO_OVERLAP.failure(
            f"Of {len(photos)} photos no three show the same ground (at most {len(largest)} overlap); "
            f"expected {FEWEST_PHOTOS} or more. Lay a printed cloth or paper under the fruit and take "
            "the photos again."
        )
    scene = _started(pairs, largest, size, focal_px)
    lacking = _lacking(photos, largest, [place_of(p) for p in scene.poses], aim_of(scene.poses))
    joined_names = listed([photos[i].name for i in largest])
    return ReconProblem.NO_OVERLAP.failure(f"The ground connects only {joined_names}. {lacking}")


def _started(
    pairs: Sequence[GroundPair], members: Sequence[int], size: tuple[int, int], focal_px: float | None
) -> PlaneScene:
    """Poses and focal length from the homographies, then from all matches."""
    _, from_first = chained(pairs, members)
    start_px, poses = start_cameras(from_first, size, focal_px)
    K = pinhole(start_px, size)
    number = {m: i for i, m in enumerate(members)}
    inner = [p for p in pairs if p.a in number and p.b in number]
    most = max(8, MOST_POINTS // len(inner))
    view, places, ground = [], [], []
    for pair in inner:
        some = np.unique(np.linspace(0, len(pair.places_a) - 1, most).astype(int))
        a, b = pair.places_a[some], pair.places_b[some]
        pose = poses[pair.a]
        onto = np.linalg.inv(K @ pose[:3, [0, 1, 3]])
        at = np.column_stack([a, np.ones(len(a))]) @ onto.T
        ahead = at[:, 2] > 1e-9  # the inverse of the depth
        ground.append(at[ahead, :2] / at[ahead, 2:])
        places.append(np.stack([a[ahead], b[ahead]], axis=1))
        view.append(np.tile([number[pair.a], number[pair.b]], (int(ahead.sum()), 1)))
    at = np.concatenate(ground)
    away = np.linalg.norm(at - np.median(at, axis=0), axis=1)
    near = away < 10 * np.median(away)
    seen = Sightings(
        np.concatenate(view)[near].ravel(),
        np.repeat(np.arange(int(near.sum())), 2),
        np.concatenate(places)[near].reshape(-1, 2),
        np.tile(np.eye(2), (2 * int(near.sum()), 1, 1)),
    )
    scene = PlaneScene(np.stack([poses[m] for m in members]), np.full(len(members), start_px), 0.0, at[near])
    prior = _focal_prior(size, focal_px)
    return adjusted(scene, seen, size, focal_prior=prior, breathing_sd=RIGID, loss_px=START_LOSS_PX).scene


def _focal_prior(size: tuple[int, int], focal_px: float | None) -> tuple[float, float]:
    if focal_px is not None:
        return float(np.log(focal_px)), KNOWN_FOCAL_SD
    return float(np.log(USUAL_FOCAL * max(size))), USUAL_FOCAL_SD


def _refined(
    photos: Sequence[Photo], scene: PlaneScene, size: tuple[int, int], focal_px: float | None
) -> Adjusted:
    """The scene from patches of the ground, searched in ever smaller windows."""
    adjustment = None
    for search_px in SEARCHES_PX:
        seen, ground = ground_tracks(photos, scene, aim_of(scene.poses)[:2], search_px=search_px)
        least = np.bincount(seen.view, minlength=len(photos)).min()
        if len(ground) < FEWEST_TRACKS or least < 8:
            break
        start = PlaneScene(scene.poses, scene.focals_px, scene.k1, ground)
        adjustment = adjusted(start, seen, size, focal_prior=_focal_prior(size, focal_px), loss_px=LOSS_PX)
        scene = adjustment.scene
    if adjustment is None or float(np.median(adjustment.miss_px)) > MOST_MISS_PX:
        raise ReconProblem.NO_OVERLAP.failure(
            "The common ground of the photos is not flat, or has too little texture; expected at "
            f"least {FEWEST_TRACKS} patches within {MOST_MISS_PX:g} px of one plane. Lay a printed "
            "cloth or paper flat under the fruit, or use the mat (drupe mat)."
        )
    return adjustment


def placed(
    photos: Sequence[Photo], cameras: Sequence[Camera], height_mm: float, model: FruitModel | None = None
) -> tuple[Float[np.ndarray, "4 4"], Box]:
    """Shift and scale to about millimetres with the fruit on the z axis, and the box that contains it.

    The fruit is the block on the ground, near the cameras' aim, on which the photos agree. `model` adds its
    log odds, since without a mat the ground may have the fruit's colours. Raises ReconFailure (no-fruit).
    """
    distance = float(np.median([np.linalg.norm(c.place) for c in cameras]))
    guess = scaling(100 / distance)
    pairs = [straightened(p, c.moved(guess)) for p, c in zip(photos, cameras, strict=True)]
    images, plain = [image for image, _ in pairs], [camera for _, camera in pairs]
    scene = SegmentationScene(images, plain, *box_about_z(32.0, 55.0), model)
    cells = first_block(scene).points * distance / 100
    low, high = cells.min(0), cells.max(0)
    factor = height_mm / high[2]
    world = affine(factor * np.eye(3), -factor * (low + high) / 2 * [1, 1, 0])
    half = factor * 0.85 * max(float((high - low)[:2].max()), float(high[2]))
    return world, box_about_z(half, 1.7 * height_mm)
