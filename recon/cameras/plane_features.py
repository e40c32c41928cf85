"""Features of the ground, matched in pictures as from above, which differ by a turn and a shift only."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.cameras.camera import pinhole
from recon.cameras.photos import Photo

SINES = (0.25, 0.45, 0.72, 1.0)
"""Sines of the elevations from which photos are tried to have been taken: within a factor of 1.35 of every
one from 11 degrees up, and SIFT stands tilts of 1.5 to 2 (Morel, Yu 2009, SIAM J. Imaging Sci. 2:438)."""
USUAL_FOCAL = 1.15
"""Focal length over the longest side where EXIF is silent: phones' main cameras have 0.7 to 1.5."""
REACH = 0.75
"""Half side of the ground looked at, over the distance from camera to ground along the optical axis."""
RATIO = 0.85
"""Of a match's distance to the next best one's, at most (Lowe 2004: 0.8; here both photos must agree)."""
FEWEST_INLIERS = 14
"""Matches that fit one homography, at least: eight numbers are fitted, and chance fits some. Set by hand."""
INLIER_PX = 4.0
"""px by which a match may miss, of pictures from above at their first, rough cameras. Set by hand."""


@dataclass(frozen=True)
class GroundFeatures:
    """Places in a photo's own pixels (pixel centres whole) and unit descriptors, for each of SINES."""

    places_px: tuple[Float[np.ndarray, "_n 2"], ...]
    descriptors: tuple[Float[np.ndarray, "_n 128"], ...]


@dataclass(frozen=True)
class GroundPair:
    """Photos `a` and `b`, matched places in each, and the homography of the ground that takes a's to b's."""

    a: int
    b: int
    places_a: Float[np.ndarray, "n 2"]
    places_b: Float[np.ndarray, "n 2"]
    b_from_a: Float[np.ndarray, "3 3"]


def down_view(
    size: tuple[int, int], focal_px: float, sine: float
) -> tuple[Float[np.ndarray, "3 3"], tuple[int, int]]:
    """The homography from a photo of (height, width) to its ground as from straight above, and that
    picture's (width, height), for a camera held level whose axis meets the ground at arcsin(`sine`).
    """
    cosine = float(np.sqrt(max(1.0 - sine * sine, 0.0)))
    turn = np.array([[1.0, 0, 0], [0, sine, -cosine], [0, cosine, sine]])
    scale = 0.8 * focal_px * np.sqrt(sine)
    half = REACH * scale
    side = round(2 * half)
    onto = np.array([[scale * sine, 0, half], [0, scale * sine, half + scale * cosine], [0, 0, 1]])
    return onto @ turn @ np.linalg.inv(pinhole(focal_px, size)), (side, side)


def ground_features(photo: Photo, *, most: int) -> GroundFeatures:
    """RootSIFT features (Lowe 2004; Arandjelovic, Zisserman 2012) of the photo's ground as from above."""
    grey = cv2.cvtColor(photo.image, cv2.COLOR_BGR2GRAY)
    focal_px = photo.focal_px or USUAL_FOCAL * max(grey.shape)
    sift = cv2.SIFT.create(nfeatures=most, contrastThreshold=0.01, edgeThreshold=12)
    places, descriptors = [], []
    for sine in SINES:
        H, size = down_view((grey.shape[0], grey.shape[1]), focal_px, sine)
        seen = cv2.warpPerspective(grey, H, size, flags=cv2.INTER_AREA)
        inside = cv2.warpPerspective(np.full_like(grey, 255), H, size, flags=cv2.INTER_NEAREST)
        ahead = _ahead(H, size)
        mask = cv2.erode(np.where(ahead, inside, 0).astype(np.uint8), np.ones((17, 17), np.uint8))
        points, sift_descriptors = sift.detectAndCompute(seen, mask)
        at = np.array([p.pt for p in points], float).reshape(-1, 1, 2)
        if len(at) == 0:
            places.append(np.empty((0, 2)))
            descriptors.append(np.empty((0, 128), np.float32))
            continue
        places.append(cv2.perspectiveTransform(at, np.linalg.inv(H))[:, 0])
        root = np.sqrt(sift_descriptors / np.maximum(sift_descriptors.sum(1, keepdims=True), 1e-9))
        descriptors.append(root.astype(np.float32))
    return GroundFeatures(tuple(places), tuple(descriptors))


def _ahead(H: Float[np.ndarray, "3 3"], size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Where the picture from above is of rays ahead of the camera."""
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    back = np.linalg.inv(H)
    return np.asarray((back[2, 0] * x + back[2, 1] * y + back[2, 2]) * np.sign(back[2, 2]) > 0)


def ground_pairs(features: Sequence[GroundFeatures]) -> list[GroundPair]:
    """Pairs of photos whose ground is the same plane: at least FEWEST_INLIERS matches fit one homography."""
    pairs = (_pair(a, b, features[a], features[b]) for a, b in combinations(range(len(features)), 2))
    return [pair for pair in pairs if pair is not None]


def _pair(a: int, b: int, first: GroundFeatures, second: GroundFeatures) -> GroundPair | None:
    """Matches of two photos' features that one homography explains; None for too few."""
    matches = []
    for places_a, descriptors_a in zip(first.places_px, first.descriptors, strict=True):
        for places_b, descriptors_b in zip(second.places_px, second.descriptors, strict=True):
            i, j = _mutual(descriptors_a, descriptors_b)
            if len(i):
                matches.append((places_a[i], places_b[j]))
    if not matches:
        return None
    at_a, at_b = (np.concatenate(part) for part in zip(*matches, strict=True))
    if len(at_a) < FEWEST_INLIERS:
        return None
    H, inside = cv2.findHomography(at_a, at_b, cv2.USAC_MAGSAC, INLIER_PX, maxIters=10000, confidence=0.9999)
    if H is None:
        return None
    keep = inside[:, 0] > 0
    _, once = np.unique(np.rint(at_a[keep] / 4), axis=0, return_index=True)
    if len(once) < FEWEST_INLIERS:
        return None
    return GroundPair(a, b, at_a[keep][once], at_b[keep][once], H)


def _mutual(
    a: Float[np.ndarray, "n 128"], b: Float[np.ndarray, "m 128"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Indices of descriptors that are each other's nearest, and clearly nearer than the next."""
    if len(a) < 2 or len(b) < 2:
        return np.empty(0, int), np.empty(0, int)
    like = a @ b.T
    j = like.argmax(axis=1)
    i = np.arange(len(a))
    best = like[i, j]
    back = like.argmax(axis=0)
    like[i, j] = -1
    second = like.max(axis=1)
    good = (back[j] == i) & (1 - best < RATIO**2 * (1 - second))
    return i[good], j[good]
