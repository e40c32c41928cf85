"""Start cameras: the focal length and tilt with which homographies preserve the flat ground's metric."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares

from recon.cameras.camera import pinhole
from recon.cameras.photos import Photo
from recon.cameras.similarity import affine
from recon.triangle_mesh import parts_of

SINES = (0.25, 0.45, 0.72, 1.0)
"""Sines of the tried elevations, within a factor of 1.35 of that of any elevation above 11 degrees. SIFT
tolerates tilts of 1.5 to 2 (Morel, Yu 2009, SIAM J. Imaging Sci. 2:438)."""
USUAL_FOCAL = 1.15
"""Focal length over the longest side without EXIF: phones' main cameras have 0.7 to 1.5."""
REACH = 0.75
"""Half side of the top view, over the distance from camera to ground along the optical axis."""
RATIO = 0.85
"""Largest ratio of a match's distance to the next best's (Lowe 2004: 0.8; here both photos must agree)."""
FEWEST_INLIERS = 14
"""Least number of matches on one homography: it has eight parameters, and chance fits some. Set by hand."""
INLIER_PX = 4.0
"""Largest residual of a match, px of the photo: features are from top views of rough cameras. Set by hand."""


@dataclass(frozen=True)
class GroundFeatures:
    """Places in a photo's own pixels (centres are integers) and unit descriptors, for each of SINES."""

    places_px: tuple[Float[np.ndarray, "_n 2"], ...]
    descriptors: tuple[Float[np.ndarray, "_n 128"], ...]


@dataclass(frozen=True)
class GroundPair:
    """Photos `a` and `b`, matched places in each, and the homography of the ground from a to b."""

    a: int
    b: int
    places_a: Float[np.ndarray, "n 2"]
    places_b: Float[np.ndarray, "n 2"]
    b_from_a: Float[np.ndarray, "3 3"]


def down_view(
    size: tuple[int, int], focal_px: float, sine: float
) -> tuple[Float[np.ndarray, "3 3"], tuple[int, int]]:
    """The homography from a photo of (height, width) to its top view, and the top view's (width, height). The
    camera has no roll, and its axis meets the ground at arcsin(`sine`).
    """
    cosine = float(np.sqrt(max(1.0 - sine * sine, 0.0)))
    turn = np.array([[1.0, 0, 0], [0, sine, -cosine], [0, cosine, sine]])
    scale = 0.8 * focal_px * np.sqrt(sine)
    half = REACH * scale
    side = round(2 * half)
    onto = np.array([[scale * sine, 0, half], [0, scale * sine, half + scale * cosine], [0, 0, 1]])
    return onto @ turn @ np.linalg.inv(pinhole(focal_px, size)), (side, side)


def ground_features(photo: Photo, *, most: int) -> GroundFeatures:
    """RootSIFT features (Lowe 2004; Arandjelovic, Zisserman 2012) of top views of the photo's ground."""
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
    """Mask of the pixels of the top view that lie in front of the camera."""
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


FOCALS = np.geomspace(0.55, 3.2, 14)
"""Tried focal lengths over the longest side: phones from ultra-wide to a threefold zoom."""
ELEVATIONS_DEG = np.arange(8.0, 90.0, 6.0)
"""Start elevations of a camera above the ground: the search converges over half a step."""
ROLLS_DEG = np.array([-12.0, -6.0, 0.0, 6.0, 12.0])
"""Start rolls of a hand-held camera about its axis: the search converges over half a step."""
FINALISTS = 5
"""Number of best starts that are optimised. Set by hand."""
KNOWN_FOCAL_SD, USUAL_FOCAL_SD = 0.03, 0.6
"""Spread of the logarithm of the focal length about EXIF's, or about the usual one."""


def joined(pairs: Sequence[GroundPair], count: int) -> list[list[int]]:
    """Groups of photos that pairs connect, the largest first."""
    part = parts_of(np.array([(p.a, p.b) for p in pairs], int).reshape(-1, 2), count)
    groups = [np.flatnonzero(part == k).tolist() for k in np.unique(part)]
    return sorted(groups, key=lambda g: (-len(g), g[0]))


def chained(
    pairs: Sequence[GroundPair], members: Sequence[int]
) -> tuple[int, dict[int, Float[np.ndarray, "3 3"]]]:
    """The best connected photo, and the homographies from it to each of `members` along the strongest pairs.

    The tree maximises the numbers of matches (Prim), so that a false pair with few of them is not used.
    """
    weight: dict[int, float] = dict.fromkeys(members, 0.0)
    for p in pairs:
        if p.a in weight and p.b in weight:
            weight[p.a] += len(p.places_a)
            weight[p.b] += len(p.places_a)
    first = max(members, key=lambda m: weight[m])
    out = {first: np.eye(3)}
    while True:
        ahead = [p for p in pairs if (p.a in out) != (p.b in out)]
        if not ahead:
            return first, out
        best = max(ahead, key=lambda p: len(p.places_a))
        if best.a in out:
            out[best.b] = best.b_from_a @ out[best.a]
        else:
            out[best.a] = np.linalg.inv(best.b_from_a) @ out[best.b]


def start_cameras(
    from_first: dict[int, Float[np.ndarray, "3 3"]], size: tuple[int, int], known_focal_px: float | None
) -> tuple[float, dict[int, Float[np.ndarray, "4 4"]]]:
    """Focal length (px) and cam_from_world of each photo; the world's z = 0 is the ground, in any unit.

    H = K R' is the homography from the metric ground to the first photo. Columns a, b of K^-1 H_i H are
    orthogonal and equally long in every photo i (Zhang 2000; Triggs 1998, autocalibration from planar
    scenes). Minimises sum ((|a|² - |b|²)² + (2 a.b)²) / (|a|² + |b|²)², robustly, over focal length,
    elevation and roll of the first camera, from a grid of starts.
    """
    names = sorted(from_first)
    H = np.stack([from_first[i] for i in names])
    longest = max(size)
    about = np.log(known_focal_px or USUAL_FOCAL * longest)
    spread = KNOWN_FOCAL_SD if known_focal_px else USUAL_FOCAL_SD

    def misses(x: Float[np.ndarray, "3"]) -> Float[np.ndarray, " m"]:
        K = pinhole(float(np.exp(x[0])), size)
        A = np.linalg.inv(K) @ H @ (K @ _down(x[1], x[2]).T)
        a, b = A[:, :, 0], A[:, :, 1]
        total = np.sum(a * a, 1) + np.sum(b * b, 1)
        off = np.concatenate([np.sum(a * a - b * b, 1) / total, 2 * np.sum(a * b, 1) / total])
        return np.append(off, 0.02 * (x[0] - about) / spread)

    starts = [
        np.array([np.log(f * longest), np.radians(e), np.radians(r)])
        for f in (FOCALS if known_focal_px is None else [known_focal_px / longest])
        for e in ELEVATIONS_DEG
        for r in ROLLS_DEG
    ]
    costs = [float(np.sum(np.minimum(np.abs(misses(x)), 0.3))) for x in starts]
    tried = [
        least_squares(misses, starts[i], loss="soft_l1", f_scale=0.02) for i in np.argsort(costs)[:FINALISTS]
    ]
    best = min(tried, key=lambda fit: float(fit.cost)).x
    focal = float(np.exp(best[0]))
    K = pinhole(focal, size)
    plane = K @ _down(best[1], best[2]).T
    poses = {}
    for name, h in zip(names, H, strict=True):
        A = np.linalg.inv(K) @ h @ plane
        A /= np.sqrt(np.linalg.norm(A[:, 0]) * np.linalg.norm(A[:, 1]))
        poses[name] = _pose(A)
    return focal, poses


def _pose(A: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4 4"]:
    """The rigid transform nearest to columns r1, r2, t, with the camera on the side of the ground with z > 0.

    A homography has no sign: r1, r2, t and their negatives put the camera on opposite sides. Its height is
    -(r1 x r2) . t. The plane's frame of `_down` has z into the ground; x is reversed to have z up.
    """
    r1, r2, t = -A[:, 0], A[:, 1], A[:, 2]
    if np.cross(r1, r2) @ t > 0:
        r1, r2, t = -r1, -r2, -t
    U, _, V = np.linalg.svd(np.column_stack([r1, r2, np.cross(r1, r2)]))
    return affine(U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V, t)


def _down(elevation: float, roll: float) -> Float[np.ndarray, "3 3"]:
    """The rotation from a camera's axes to those of one that looks straight down (angles in rad)."""
    s, c = np.sin(elevation), np.cos(elevation)
    level = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1.0]])
    return np.asarray(np.array([[1.0, 0, 0], [0, s, -c], [0, c, s]]) @ level)
