"""Bundle adjustment of photos of a flat ground: its points keep to z = 0, every photo may focus anew."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

BREATHING_SD = 0.004
"""Spread of the focal length from photo to photo, relative: phones focus each one anew. Of drawn phones it is
0.002; with one focal length for all, cameras were 0.31 mm off instead of 0.16 and 0.28 instead of 0.12
(phone-002, phone-004 of benchmarks/photo_bank.py, 12 photos)."""
RIGID = 1e-4
"""The same spread where all photos share one focal length: none to speak of."""
K1_SD = 0.05
"""Spread of the radial term about none: what phones leave after their own correction."""
LOSS_PX = 1.0
"""px from where on a miss counts less than by its square: points are found to a few tenths. Set by hand."""
STEPS = 40
"""Of Gauss-Newton at most; it ends where steps no longer gain. Set by hand."""
ROUNDS, STEADY = 4, 0.02
"""How often the misses' spread is told anew at most, and the change of its logarithm that ends it (a tenth of
what 60 points tell of it)."""
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
    about where they start: infinite where nothing is known of them. Levenberg and Marquardt's steps; points
    eliminated (Schur), each a 2 x 2 block (Triggs et al. 2000, Bundle adjustment: a modern synthesis).
    Similarities of the ground are left to the damping. `size`: (height, width) of the photos.
    """
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    common = float(np.mean(np.log(scene.focals_px)))
    state = _State(scene.poses, common, np.log(scene.focals_px) - common, scene.k1, scene.ground)
    prior = _Prior(focal_prior[0], focal_prior[1], breathing_sd, scene.ground, ground_sd_mm)
    system = _normal(state, seen, middle, prior, loss_px, 1.0)
    for _ in range(ROUNDS):
        sigma_px = _spread_px(system)
        state, system = _solved(state, seen, middle, prior, loss_px, sigma_px)
        if abs(np.log(_spread_px(system) / sigma_px)) < STEADY:
            break
    k = 7 * len(scene.poses)
    away = np.linalg.norm(system.miss_px, axis=1)
    covariance = np.linalg.pinv(system.H)
    found = PlaneScene(state.poses, np.exp(state.common + state.own), state.k1, state.ground)
    return Adjusted(found, away, float(np.sqrt(max(covariance[k, k], 0.0))))


def _solved(
    state: "_State",
    seen: Sightings,
    middle: Float[np.ndarray, "2"],
    prior: "_Prior",
    loss_px: float,
    sigma_px: float,
) -> "tuple[_State, _System]":
    """The least cost at one spread of the misses."""
    damping = 1e-4
    system = _normal(state, seen, middle, prior, loss_px, sigma_px)
    for _ in range(STEPS):
        step = np.linalg.solve(system.H + damping * np.diag(np.diag(system.H)), -system.g)
        tried = _moved(state, step, system.points(step))
        new = _normal(tried, seen, middle, prior, loss_px, sigma_px)
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


def _spread_px(system: "_System") -> float:
    """Of the misses in each direction, as the median of a Rayleigh distribution tells it."""
    away = np.linalg.norm(system.miss_px, axis=1)
    return max(float(np.median(away) / np.sqrt(2 * np.log(2))), LEAST_SPREAD_PX)


@dataclass(frozen=True)
class _State:
    """What is sought: log focal lengths are `common` + `own`."""

    poses: Float[np.ndarray, "v 4 4"]
    common: float
    own: Float[np.ndarray, " v"]
    k1: float
    ground: Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class _Prior:
    common: float
    common_sd: float
    own_sd: float
    ground: Float[np.ndarray, "n 2"]
    ground_sd_mm: float


@dataclass(frozen=True)
class _System:
    """The cost, and the normal equations of cameras (turn, shift, own log focal length), common log focal
    length and k1, with the points eliminated; `inverse`, `coupling`, `slope` find those again.
    """

    cost: float
    H: Float[np.ndarray, "c c"]
    g: Float[np.ndarray, " c"]
    inverse: Float[np.ndarray, "n 2 2"]
    coupling: Float[np.ndarray, "n 2 c"]
    slope: Float[np.ndarray, "n 2"]
    miss_px: Float[np.ndarray, "k 2"]

    def points(self, step: Float[np.ndarray, " c"]) -> Float[np.ndarray, "n 2"]:
        """The points' step that goes with the cameras'."""
        return np.asarray(-np.einsum("nij,nj->ni", self.inverse, self.slope + self.coupling @ step))


def _prior_spreads(prior: _Prior, views: int) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Where own and common log focal lengths and k1 stand among the unknowns, and their prior spreads."""
    where = np.concatenate([7 * np.arange(views) + 6, [7 * views, 7 * views + 1]])
    return where, np.concatenate([np.full(views, prior.own_sd), [prior.common_sd, K1_SD]])


def _moved(state: _State, step: Float[np.ndarray, " c"], points: Float[np.ndarray, "n 2"]) -> _State:
    """The state after a step of poses, focal lengths and distortion, and of the points on the ground."""
    v = len(state.poses)
    own = step[: 7 * v].reshape(v, 7)
    poses = state.poses.copy()
    turn = Rotation.from_rotvec(own[:, :3]).as_matrix()
    poses[:, :3, :3] = turn @ state.poses[:, :3, :3]
    poses[:, :3, 3] = np.einsum("vij,vj->vi", turn, state.poses[:, :3, 3]) + own[:, 3:6]
    return _State(
        poses,
        state.common + float(step[7 * v]),
        state.own + own[:, 6],
        state.k1 + float(step[7 * v + 1]),
        state.ground + points,
    )


def _normal(
    state: _State,
    seen: Sightings,
    middle: Float[np.ndarray, "2"],
    prior: _Prior,
    loss_px: float,
    sigma_px: float,
) -> _System:
    """Normal equations of the sightings (Cauchy loss) and priors at a state, the points eliminated."""
    v, n, size = len(state.poses), len(state.ground), 7 * len(state.poses) + 2
    at = state.ground[seen.point]
    R, t = state.poses[seen.view, :3, :3], state.poses[seen.view, :3, 3]
    X = np.einsum("kij,kj->ki", R[:, :, :2], at) + t
    z = np.maximum(X[:, 2], 1e-6)
    xy = X[:, :2] / z[:, None]
    r2 = np.sum(xy**2, 1)
    f = np.exp(state.common + state.own[seen.view])
    pixel = f[:, None] * xy * (1 + state.k1 * r2)[:, None]
    miss = np.einsum("kij,kj->ki", seen.whiten, pixel + middle - seen.places_px)
    square = np.sum(miss**2, 1)
    weight = 1 / (1 + square / loss_px**2) / sigma_px**2
    cost = float(np.sum(loss_px**2 * np.log1p(square / loss_px**2))) / sigma_px**2
    bend = (1 + state.k1 * r2)[:, None, None] * np.eye(2) + 2 * state.k1 * xy[:, :, None] * xy[:, None, :]
    to_xy = np.zeros((len(at), 2, 3))
    to_xy[:, 0, 0] = to_xy[:, 1, 1] = 1 / z
    to_xy[:, :, 2] = -xy / z[:, None]
    JX = seen.whiten @ (f[:, None, None] * bend @ to_xy)
    grown = np.einsum("kij,kj->ki", seen.whiten, pixel)
    bent = np.einsum("kij,kj->ki", seen.whiten, f[:, None] * xy * r2[:, None])
    cross = np.zeros((len(at), 3, 3))  # d (turn X) / d turn = -[X]x
    cross[:, 0, 1], cross[:, 0, 2] = X[:, 2], -X[:, 1]
    cross[:, 1, 0], cross[:, 1, 2] = -X[:, 2], X[:, 0]
    cross[:, 2, 0], cross[:, 2, 1] = X[:, 1], -X[:, 0]
    own = np.concatenate([JX @ cross, JX, grown[:, :, None]], axis=2)
    shared = np.stack([grown, bent], axis=2)
    columns = np.hstack([7 * seen.view[:, None] + np.arange(7), np.full((len(at), 2), [7 * v, 7 * v + 1])])
    J = _rows(np.concatenate([own, shared], axis=2), columns, size)
    Jp = JX @ R[:, :, :2]
    Jg = _rows(Jp, 2 * seen.point[:, None] + np.arange(2), 2 * n)
    heavy = np.repeat(weight, 2)
    WJ = J * heavy[:, None]
    H, g = (J.T @ WJ).toarray(), WJ.T @ miss.ravel()
    B = (Jg.T @ WJ).toarray().reshape(n, 2, size)
    known = prior.ground_sd_mm**-2
    apart = state.ground - prior.ground
    slope = (Jg.T @ (heavy * miss.ravel())).reshape(n, 2) + known * apart
    U = np.tile(known * np.eye(2), (n, 1, 1))
    np.add.at(U, seen.point, np.swapaxes(weight[:, None, None] * Jp, 1, 2) @ Jp)
    where, sd = _prior_spreads(prior, v)
    off = np.concatenate([state.own, [state.common - prior.common, state.k1]])
    H[where, where] += 1 / sd**2
    g[where] += off / sd**2
    cost += float(np.sum((off / sd) ** 2)) + known * float(np.sum(apart**2))
    trace = np.trace(U, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(U + (1e-9 * trace + 1e-12) * np.eye(2))
    lean = B.reshape(2 * n, size)
    H = H - lean.T @ (inverse @ B).reshape(2 * n, size)
    g = g - lean.T @ np.einsum("nij,nj->ni", inverse, slope).ravel()
    H[np.diag_indices(size)] += 1e-9 * np.trace(H) / size
    return _System(cost, H, g, inverse, B, slope, miss)


def _rows(values: Float[np.ndarray, "k 2 c"], columns: Int[np.ndarray, "k c"], width: int) -> csr_array:
    """Two rows of a matrix for each sighting, with their values in these columns."""
    k, _, c = values.shape
    start = np.arange(0, 2 * k * c + 1, c)
    return csr_array((values.ravel(), np.repeat(columns, 2, axis=0).ravel(), start), shape=(2 * k, width))
