"""Bundle adjustment of photos of a flat ground: its points keep to z = 0, every photo may focus anew."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

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
"""Of Gauss-Newton at most; it ends where steps no longer gain. Set by hand."""
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
    ground_sd_mm: float = np.inf,
) -> Adjusted:
    """Poses, focal lengths, k1 and points of the least misses, with Cauchy's weights, against their priors.

    The cost is the misses' over sigma² plus the priors' over their spreads squared; sigma, the misses' own
    spread (px), is told by their median, at the start and anew after each solution (ROUNDS). log f_i =
    log f + b_i with b_i of spread `breathing_sd` about 0, k1 of spread K1_SD about 0, and log f of (mean,
    spread) `focal_prior`; `loss_px` is where a miss counts half; `ground_sd_mm` is the spread of the points
    about where they start: infinite where nothing is known of them. Levenberg and Marquardt's steps, whose
    sparse systems eliminate the points first (Triggs et al. 2000, Bundle adjustment: a modern synthesis).
    Similarities of the ground are left to the damping. `size`: (height, width) of the photos.
    """
    views = len(scene.poses)
    common = float(np.mean(np.log(scene.focals_px)))
    state = _State(scene.poses, common, np.log(scene.focals_px) - common, scene.k1, scene.ground)
    of_views = np.tile([0.0] * 6 + [breathing_sd**-2], views)
    shared, of_points = [focal_prior[1] ** -2, K1_SD**-2], np.full(scene.ground.size, ground_sd_mm**-2)
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    expected = replace(state, common=focal_prior[0])
    problem = _Problem(seen, middle, loss_px, np.concatenate([of_points, of_views, shared]), expected)
    miss_px = problem.system(state, 1.0).miss_px
    for _ in range(ROUNDS):
        sigma_px = _spread_px(miss_px)
        state, system = _solved(problem, state, sigma_px)
        miss_px = system.miss_px
        if abs(np.log(_spread_px(miss_px) / sigma_px)) < STEADY:
            break
    unit = np.zeros(len(system.g))
    unit[-2] = 1.0
    variance = float(_factor(system.H).solve(unit)[-2])
    adjusted_scene = PlaneScene(state.poses, np.exp(state.common + state.breathing), state.k1, state.ground)
    return Adjusted(adjusted_scene, np.linalg.norm(miss_px, axis=1), float(np.sqrt(max(variance, 0.0))))


def _solved(problem: "_Problem", state: "_State", sigma_px: float) -> "tuple[_State, _System]":
    """The least cost at one spread of the misses."""
    damping = 1e-4
    system = problem.system(state, sigma_px)
    for _ in range(STEPS):
        step = _factor(system.H + damping * diags_array(system.H.diagonal())).solve(-system.g)
        tried = state.moved(step)
        new = problem.system(tried, sigma_px)
        if new.cost < system.cost:
            done = system.cost - new.cost < 1e-5 * system.cost
            state, system = tried, new
            damping = max(damping / 5, 1e-9)
            if done:
                break
        else:
            damping *= 8
            if damping > 1e6:
                break
    return state, system


def _factor(matrix: csr_array) -> SuperLU:
    """A symmetric positive definite matrix, factored in its order: points before cameras."""
    symmetric = {"SymmetricMode": True}
    return splu(csc_array(matrix), permc_spec="NATURAL", diag_pivot_thresh=0.0, options=symmetric)


def _spread_px(miss_px: Float[np.ndarray, "k 2"]) -> float:
    """Of the misses in each direction, as the median of a Rayleigh distribution tells it."""
    away = np.linalg.norm(miss_px, axis=1)
    return max(float(np.median(away) / np.sqrt(2 * np.log(2))), LEAST_SPREAD_PX)


@dataclass(frozen=True)
class _State:
    """What is sought: log focal lengths are `common` + `breathing`."""

    poses: Float[np.ndarray, "v 4 4"]
    common: float
    breathing: Float[np.ndarray, " v"]
    k1: float
    ground: Float[np.ndarray, "n 2"]

    def moved(self, step: Float[np.ndarray, " u"]) -> "_State":
        """After a step of the points, of each view's turn, shift and breathing, and of log f and k1."""
        of_points, of_views = (
            step[: self.ground.size].reshape(-1, 2),
            step[self.ground.size : -2].reshape(-1, 7),
        )
        poses = self.poses.copy()
        turn = Rotation.from_rotvec(of_views[:, :3]).as_matrix()
        poses[:, :3, :3] = turn @ self.poses[:, :3, :3]
        poses[:, :3, 3] = np.einsum("vij,vj->vi", turn, self.poses[:, :3, 3]) + of_views[:, 3:6]
        common, k1 = np.array([self.common, self.k1]) + step[-2:]
        return _State(
            poses, float(common), self.breathing + of_views[:, 6], float(k1), self.ground + of_points
        )

    def apart(self, expected: "_State") -> Float[np.ndarray, " u"]:
        """What priors know of the unknowns (poses: nothing), less what is expected of them."""
        of_views = np.zeros((len(self.poses), 7))
        of_views[:, 6] = self.breathing
        shared = [self.common - expected.common, self.k1]
        return np.concatenate([(self.ground - expected.ground).ravel(), of_views.ravel(), shared])


@dataclass(frozen=True)
class _System:
    """The cost, its normal equations and the misses (px, whitened) at a state."""

    cost: float
    H: csr_array
    g: Float[np.ndarray, " u"]
    miss_px: Float[np.ndarray, "k 2"]


@dataclass(frozen=True)
class _Problem:
    """Sightings, the photos' middle, where a miss counts half, the priors' 1 / spread² and expected state."""

    seen: Sightings
    middle: Float[np.ndarray, "2"]
    loss_px: float
    precision: Float[np.ndarray, " u"]
    expected: _State

    def system(self, state: _State, sigma_px: float) -> _System:
        """Normal equations of the sightings (Cauchy loss) and priors at a state."""
        seen, unknowns = self.seen, len(self.precision)
        at = state.ground[seen.point]
        R, t = state.poses[seen.view, :3, :3], state.poses[seen.view, :3, 3]
        X = np.einsum("kij,kj->ki", R[:, :, :2], at) + t
        z = np.maximum(X[:, 2], 1e-6)
        xy = X[:, :2] / z[:, None]
        r2 = np.sum(xy**2, 1)
        f = np.exp(state.common + state.breathing[seen.view])
        pixel = f[:, None] * xy * (1 + state.k1 * r2)[:, None]
        miss = np.einsum("kij,kj->ki", seen.whiten, pixel + self.middle - seen.places_px)
        bend = (1 + state.k1 * r2)[:, None, None] * np.eye(2) + 2 * state.k1 * xy[:, :, None] * xy[:, None]
        to_xy = np.zeros((len(at), 2, 3))
        to_xy[:, 0, 0] = to_xy[:, 1, 1] = 1 / z
        to_xy[:, :, 2] = -xy / z[:, None]
        JX = seen.whiten @ (f[:, None, None] * bend @ to_xy)
        grown = np.einsum("kij,kj->ki", seen.whiten, pixel)[:, :, None]
        bent = np.einsum("kij,kj->ki", seen.whiten, f[:, None] * xy * r2[:, None])[:, :, None]
        turned = np.cross(JX, -X[:, None])  # row . d (turn X) / d turn = row . -[X]x
        values = np.concatenate([JX @ R[:, :, :2], turned, JX, grown, grown, bent], axis=2)
        of_point = 2 * seen.point[:, None] + np.arange(2)
        of_view = state.ground.size + 7 * seen.view[:, None] + np.arange(7)
        shared = np.full((len(at), 2), [unknowns - 2, unknowns - 1])
        columns = np.hstack([of_point, of_view, shared])
        start = np.arange(0, values.size + 1, values.shape[2])
        place = np.repeat(columns, 2, axis=0).ravel()
        J = csr_array((values.ravel(), place, start), shape=(miss.size, unknowns))
        square = np.sum(miss**2, 1) / self.loss_px**2
        WJ = diags_array(np.repeat(1 / (1 + square) / sigma_px**2, 2)) @ J
        apart = state.apart(self.expected)
        cost = self.loss_px**2 * np.sum(np.log1p(square)) / sigma_px**2 + self.precision @ apart**2
        H = csr_array(J.T @ WJ + diags_array(self.precision))
        H += 1e-9 * H.trace() / unknowns * eye_array(unknowns)
        return _System(float(cost), H, WJ.T @ miss.ravel() + self.precision * apart, miss)
