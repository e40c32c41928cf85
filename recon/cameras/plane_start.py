"""First cameras: the focal length and tilt for which homographies show the same flat ground to scale."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from recon.cameras.camera import pinhole
from recon.cameras.plane_features import USUAL_FOCAL, GroundPair
from recon.cameras.similarity import affine
from recon.triangle_mesh import parts_of

FOCALS = np.geomspace(0.55, 3.2, 14)
"""Tried focal lengths over the longest side: phones from ultra-wide to a threefold zoom."""
ELEVATIONS_DEG = np.arange(8.0, 90.0, 6.0)
"""Of a camera above the ground, tried as starts: the search finds its way over half a step."""
ROLLS_DEG = np.array([-12.0, -6.0, 0.0, 6.0, 12.0])
"""Of a hand-held camera about its axis, likewise."""
FINALISTS = 5
"""Best starts that are searched to their end. Set by hand."""
KNOWN_FOCAL_SD, USUAL_FOCAL_SD = 0.03, 0.6
"""Spread of the logarithm of the focal length about EXIF's, or about the usual one."""


def joined(pairs: Sequence[GroundPair], count: int) -> list[list[int]]:
    """The groups of photos that hang together by pairs, the largest first."""
    part = parts_of(np.array([(p.a, p.b) for p in pairs], int).reshape(-1, 2), count)
    groups = [np.flatnonzero(part == k).tolist() for k in np.unique(part)]
    return sorted(groups, key=lambda g: (-len(g), g[0]))


def chained(
    pairs: Sequence[GroundPair], members: Sequence[int]
) -> tuple[int, dict[int, Float[np.ndarray, "3 3"]]]:
    """The best connected photo, and the homographies from it to each of `members` along the strongest pairs.

    The tree is that of the most matches (Prim), so that a false pair with few of them is not used.
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

    With H = K R' the homography from the ground in its own metric frame to the first photo, K^-1 H_i H must
    have first columns a, b that are orthogonal and equally long in every photo i (Zhang 2000; Triggs 1998,
    autocalibration from planar scenes): minimises sum ((|a|² - |b|²)² + (2 a.b)²) / (|a|² + |b|²)², robustly,
    over focal length, elevation and roll of the first camera, from a grid of starts.
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
    """The rigid motion nearest to columns r1, r2, t, with the camera on the side of the ground where z > 0.

    A homography has no sign: r1, r2, t and their negatives differ by the side that the camera is on, whose
    height is -(r1 x r2) . t. The plane's own frame of `_down` has z into the ground; x is turned over to have
    it upwards.
    """
    r1, r2, t = -A[:, 0], A[:, 1], A[:, 2]
    if np.cross(r1, r2) @ t > 0:
        r1, r2, t = -r1, -r2, -t
    U, _, V = np.linalg.svd(np.column_stack([r1, r2, np.cross(r1, r2)]))
    return affine(U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V, t)


def _down(elevation: float, roll: float) -> Float[np.ndarray, "3 3"]:
    """Turns a camera's axes into those of one that looks straight down."""
    s, c = np.sin(elevation), np.cos(elevation)
    level = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1.0]])
    return np.asarray(np.array([[1.0, 0, 0], [0, s, -c], [0, c, s]]) @ level)
