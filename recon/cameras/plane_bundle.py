"""Bundle adjustment of photos of a flat ground (z = 0), with a focal length per photo."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from recon.cameras.camera import middle_of

BREATHING_SD = 0.004
"""Relative spread of the focal length between photos, as phones refocus (0.002 in rendered ones). With 0,
cameras were 0.31 instead of 0.16 mm off (phone-002 of benchmarks/photo_bank.py, 12 photos)."""
RIGID = 1e-4
"""The same spread if all photos share one focal length: practically zero."""
K1_SD = 0.05
"""Spread of the radial term about zero: the residual of the phones' own correction."""
LOSS_PX = 1.0
"""Scale of Cauchy's loss, px: points are found to a few tenths. Set by hand."""
STEPS = 40
"""Most evaluations of the solver; it ends when steps no longer improve the fit. Set by hand."""
ROUNDS, STEADY = 4, 0.02
"""Most estimates of the residuals' spread, and the change of its logarithm that ends them. By hand."""
LEAST_SPREAD_PX = 1e-3
"""Least spread of the residuals, px: avoids a division by zero for exact data."""


@dataclass(frozen=True)
class PlaneScene:
    """Poses (cam_from_world), focal length of each photo (px), the radial term, and ground points (z = 0)."""

    poses: Float[np.ndarray, "v 4 4"]
    focals_px: Float[np.ndarray, " v"]
    k1: float
    ground: Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Sightings:
    """Observation k is point `point[k]` in photo `view[k]` at `places_px[k]` (pixel centres are integers).

    `whiten[k]` gives a residual in pixels equal spread in all directions: a patch is located less precisely
    along the grain of wood than across.
    """

    view: Int[np.ndarray, " k"]
    point: Int[np.ndarray, " k"]
    places_px: Float[np.ndarray, "k 2"]
    whiten: Float[np.ndarray, "k 2 2"]

    def kept(self, keep: Bool[np.ndarray, " k"]) -> "Sightings":
        """The sightings that `keep` marks."""
        return Sightings(self.view[keep], self.point[keep], self.places_px[keep], self.whiten[keep])


@dataclass(frozen=True)
class Adjusted:
    """The adjusted scene, each sighting's whitened residual (px), and the sd of the log focal length."""

    scene: PlaneScene
    miss_px: Float[np.ndarray, " k"]
    focal_sd: float


def projected(
    scene: PlaneScene,
    view: Int[np.ndarray, " k"],
    at: Float[np.ndarray, "k 2"],
    middle: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "k 2"]:
    """Pixels of the ground points `at` in the photos `view`."""
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
    """Poses, focal lengths, k1 and points of least residuals, with Cauchy's loss, and priors.

    The cost is the residuals² / sigma² plus the priors' squared deviations over their spreads. The residuals'
    spread sigma (px) comes from their median, at the start and after each solution (ROUNDS). Priors: log f_i
    = log f + b_i, b_i of spread `breathing_sd` about 0. k1 has spread K1_SD about 0, log f (mean, spread)
    `focal_prior`. A residual of `loss_px` has half weight; `ground_held` fixes the points. SciPy's trust
    region solves this with sparse differences; its shortest steps fix the similarity of a free ground.
    `size`: (height, width) of the photos.
    """
    views, points = len(scene.poses), 0 if ground_held else scene.ground.size
    middle = middle_of(size)
    common = float(np.mean(np.log(scene.focals_px)))
    x = np.zeros(points + 7 * views + 2)
    x[:points] = scene.ground.ravel()[:points]
    x[points + 6 : -2 : 7] = np.log(scene.focals_px) - common
    x[-2:] = common, scene.k1

    def scene_at(x: Float[np.ndarray, " u"]) -> PlaneScene:
        """The scene with changes of points, of each view's pose and log focal length, of log f and of k1."""
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
    """Sparsity of the Jacobian of `adjusted`."""
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
    """Standard deviation of the residuals in each direction, by the median of a Rayleigh distribution."""
    away = np.linalg.norm(miss_px, axis=1)
    return max(float(np.median(away) / np.sqrt(2 * np.log(2))), LEAST_SPREAD_PX)
