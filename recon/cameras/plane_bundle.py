"""Bundle adjustment of photos of a flat ground: its points keep to z = 0, every photo may focus anew."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from recon.cameras.camera import middle_of

BREATHING_SD = 0.004
"""Relative spread of the focal length from photo to photo: phones focus each one anew (drawn ones: 0.002).
With 0, cameras were 0.31 instead of 0.16 mm off (phone-002 of benchmarks/photo_bank.py, 12 photos)."""
RIGID = 1e-4
"""The same spread where all photos share one focal length: none to speak of."""
K1_SD = 0.05
"""Spread of the radial term about none: what phones leave after their own correction."""
LOSS_PX = 1.0
"""px from where on a miss counts less than by its square: points are found to a few tenths. Set by hand."""
STEPS = 40
"""Of the search at most; it ends where steps no longer gain. Set by hand."""
ROUNDS, STEADY = 4, 0.02
"""How often the misses' spread is told anew, and the change of its logarithm that ends it (by hand)."""
LEAST_SPREAD_PX = 1e-3
"""px, least spread of the misses: keeps exact data from a division by zero."""


@dataclass(frozen=True)
class PlaneScene:
    """Poses (cam_from_world), focal length of each photo (px), the radial term, and ground points (z = 0)."""

    poses: Float[np.ndarray, "v 4 4"]
    focals_px: Float[np.ndarray, " v"]
    k1: float
    ground: Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Sightings:
    """Observation k is point `point[k]` in photo `view[k]` at `places_px[k]` (pixel centres whole).

    `whiten[k]` makes a miss in pixels one of even spread in all directions: along a streak of wood a patch
    is found worse than across.
    """

    view: Int[np.ndarray, " k"]
    point: Int[np.ndarray, " k"]
    places_px: Float[np.ndarray, "k 2"]
    whiten: Float[np.ndarray, "k 2 2"]

    def kept(self, keep: Bool[np.ndarray, " k"]) -> "Sightings":
        """Some of them."""
        return Sightings(self.view[keep], self.point[keep], self.places_px[keep], self.whiten[keep])


@dataclass(frozen=True)
class Adjusted:
    """The scene adjusted, each sighting's miss in px, and the standard deviation of the log focal length."""

    scene: PlaneScene
    miss_px: Float[np.ndarray, " k"]
    focal_sd: float


def projected(
    scene: PlaneScene,
    view: Int[np.ndarray, " k"],
    at: Float[np.ndarray, "k 2"],
    middle: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "k 2"]:
    """Pixels of ground points."""
    R, t = scene.poses[view, :3, :3], scene.poses[view, :3, 3]
    X = np.einsum("kij,kj->ki", R[:, :, :2], at) + t
    xy = X[:, :2] / X[:, 2:]
    return np.asarray(
        scene.focals_px[view, None] * xy * (1 + scene.k1 * np.sum(xy**2, 1, keepdims=True)) + middle
    )


def adjusted(
    scene: PlaneScene,
    seen: Sightings,
    size: tuple[int, int],
    *,
    focal_prior: tuple[float, float],
    breathing_sd: float = BREATHING_SD,
    loss_px: float = LOSS_PX,
    ground_held: bool = False,
) -> Adjusted:
    """Poses, focal lengths, k1 and points of the least misses, with Cauchy's weights, against their priors.

    The cost is the misses' over sigma² plus the priors' over their spreads squared; sigma, the misses' own
    spread (px), is told by their median, at the start and anew after each solution (ROUNDS). log f_i =
    log f + b_i with b_i of spread `breathing_sd` about 0, k1 of spread K1_SD about 0, and log f of (mean,
    spread) `focal_prior`; `loss_px` is where a miss counts half; `ground_held`: the points stay where they
    start. By SciPy's trust region with sparse derivatives by differences; similarities of a ground that is
    not held are left to its shortest steps. `size`: (height, width) of the photos.
    """
    views, points = len(scene.poses), 0 if ground_held else scene.ground.size
    middle = middle_of(size)
    common = float(np.mean(np.log(scene.focals_px)))
    x = np.zeros(points + 7 * views + 2)
    x[:points] = scene.ground.ravel()[:points]
    x[points + 6 : -2 : 7] = np.log(scene.focals_px) - common
    x[-2:] = common, scene.k1

    def scene_at(x: Float[np.ndarray, " u"]) -> PlaneScene:
        """After moves of the points, of each view's turn, shift and breathing, and of log f and k1."""
        of_views = x[points:-2].reshape(-1, 7)
        poses, turn = scene.poses.copy(), Rotation.from_rotvec(of_views[:, :3]).as_matrix()
        poses[:, :3, :3] = turn @ scene.poses[:, :3, :3]
        poses[:, :3, 3] = np.einsum("vij,vj->vi", turn, scene.poses[:, :3, 3]) + of_views[:, 3:6]
        ground = scene.ground if ground_held else x[:points].reshape(-1, 2)
        return PlaneScene(poses, np.exp(x[-2] + of_views[:, 6]), float(x[-1]), ground)

    def misses_px(x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "k 2"]:
        now = scene_at(x)
        away = projected(now, seen.view, now.ground[seen.point], middle) - seen.places_px
        return np.asarray(np.einsum("kij,kj->ki", seen.whiten, away))

    def residuals(x: Float[np.ndarray, " u"], sigma_px: float) -> Float[np.ndarray, " r"]:
        miss = misses_px(x)
        square = np.maximum(np.sum(miss**2, axis=1, keepdims=True) / loss_px**2, 1e-12)
        cauchy = miss * np.sqrt(np.log1p(square) / square) / sigma_px
        priors = [x[points + 6 : -2 : 7] / breathing_sd, [(x[-2] - focal_prior[0]) / focal_prior[1]]]
        return np.concatenate([cauchy.ravel(), *priors, [x[-1] / K1_SD]])

    pattern = _pattern(seen, points, views)
    miss_px = misses_px(x)
    for _ in range(ROUNDS):
        sigma_px = _spread_px(miss_px)
        fit = least_squares(
            residuals, x, jac_sparsity=pattern, x_scale="jac", args=(sigma_px,), max_nfev=STEPS, ftol=1e-6
        )
        x, miss_px = fit.x, misses_px(fit.x)
        if abs(np.log(_spread_px(miss_px) / sigma_px)) < STEADY:
            break
    J: csr_array = fit.jac  # type: ignore[assignment]  # sparse, as its pattern is
    H = csr_array(J.T @ J)
    held = csc_array(H + 1e-9 * H.trace() / len(x) * eye_array(len(x)))
    variance = float(splu(held).solve(np.eye(len(x))[-2])[-2])
    return Adjusted(scene_at(x), np.linalg.norm(miss_px, axis=1), float(np.sqrt(max(variance, 0.0))))


def _pattern(seen: Sightings, points: int, views: int) -> csr_array:
    """Which residuals of `adjusted` depend on which unknowns."""
    count, unknowns = len(seen.view), points + 7 * views + 2
    of_view = points + 7 * seen.view[:, None] + np.arange(7)
    shared = np.full((count, 2), [unknowns - 2, unknowns - 1])
    of_point = 2 * seen.point[:, None] + np.arange(2) if points else np.empty((count, 0), int)
    columns = np.repeat(np.hstack([of_point, of_view, shared]), 2, axis=0)
    rows = np.broadcast_to(np.arange(2 * count)[:, None], columns.shape)
    prior_columns = np.append(points + 6 + 7 * np.arange(views), [unknowns - 2, unknowns - 1])
    prior_rows = 2 * count + np.arange(views + 2)
    at = np.append(rows, prior_rows), np.append(columns, prior_columns)
    return csr_array((np.ones(len(at[0])), at), shape=(2 * count + views + 2, unknowns))


def _spread_px(miss_px: Float[np.ndarray, "k 2"]) -> float:
    """Of the misses in each direction, as the median of a Rayleigh distribution tells it."""
    away = np.linalg.norm(miss_px, axis=1)
    return max(float(np.median(away) / np.sqrt(2 * np.log(2))), LEAST_SPREAD_PX)
