"""Points of the ground measured in every photo that shows them, by correlation of patches as from above."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from recon.cameras.camera import place_of
from recon.cameras.photos import Photo
from recon.cameras.plane_bundle import PlaneScene, Sightings, projected
from recon.picture_values import sampled

SIDE_PX = 1000
"""Of the picture from above: about as fine as the photos show the ground. Set by hand."""
REACH = 0.6
"""Half side of the ground looked at, over the median distance of the cameras."""
EVEN_PX = 12.0
"""Brightness is evened over so many pixels: shadows and the phone's tone curve fall away."""
PATCH_PX = 10
"""Half side of a patch: 441 pixels tell a correlation to a few hundredths."""
MOST_POINTS = 700
"""Corners taken at most: more cost time and tell the same cameras. Set by hand."""
LEAST_APART_PX = 9
"""px between points: patches overlap by about half."""
LEAST_LIKE = 0.5
"""Correlation of a patch that counts as found."""
FLOOR_PX = 0.05
"""What a parabola through the correlation is off by itself."""
FEWEST_VIEWS = 3
"""Photos that show a point, at least: a median of fewer is none."""


def _from_above(
    photo: Photo, scene: PlaneScene, view: int, grid: Float[np.ndarray, "n 2"], side: int
) -> tuple[Float[np.ndarray, "s s"], Bool[np.ndarray, "s s"]]:
    """A photo's ground as from above, its brightness evened, and where it shows any."""
    grey = cv2.cvtColor(photo.image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    height, width = grey.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    at = projected(scene, np.full(len(grid), view), grid, middle)
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

    The median of all photos' grounds shows the ground without the fruit; about its corners (Shi, Tomasi
    1994) each photo is searched by normalised cross correlation within `search_px` picture elements.
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
        MOST_POINTS,
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
        height, width = photos[i].image.shape[:2]
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        views.append(np.full(len(at), i))
        points.append(np.flatnonzero(matched))
        places.append(projected(scene, views[-1], at, middle))
        steps = [projected(scene, views[-1], at + unit * e, middle) - places[-1] for e in np.eye(2)]
        px_from_element = np.stack(steps, axis=2)
        spreads.append(px_from_element @ spread[matched] @ np.swapaxes(px_from_element, 1, 2))
    W = np.linalg.inv(np.linalg.cholesky(np.concatenate(spreads)))  # the median sighting keeps its size
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
    """Without the points that fewer than FEWEST_VIEWS photos show."""
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
    """How far each corner's patch lies off in a picture, whether it was found there, and the covariance.

    Near the top the correlation is c - x' A x / 2; noise moves the top with a covariance of (1 - c) / n
    times the inverse of A, n the patch's picture elements over a blur's, and FLOOR_PX in all directions.
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
    """Top and curvature A of the quadratic fitted to 3 x 3 values; None without a top within a pixel."""
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
