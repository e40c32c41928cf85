"""Pose of the mat in the robot's base, from pictures of the mat and the flange's poses.

With the camera on the flange and the mat at rest, camera_from_mat = inv(flange_from_camera) @
inv(base_from_flange) @ base_from_mat. With the camera at rest and the mat on the flange, camera_from_mat =
inv(base_from_camera) @ base_from_flange @ flange_from_mat; pictures of the mat at its place then determine
base_from_mat. Both are A' B W with B known: a closed form for A and W starts a least-squares fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

from tactile.robot.base_and_mat import (
    MOST_SD_DEG,
    MOST_SD_MM,
    BaseAndMat,
    folds,
    motion_slopes,
    refused,
    require_noise,
    require_turns,
    rigid,
    small_motion,
)

FEWEST_POSES = 8
"""Poses with a picture: 48 equations for 12 unknowns leave enough to measure the noise. Set by hand."""
MOST_START_MM = 20.0
"""Largest miss of the mat's corners after the closed form (mm, root mean square) with which a fit starts: ten
times MOST_SD_MM, because the closed form has no weights."""
MOST_STEPS, CONVERGED = 20, 1e-4
"""Most steps of the fit, and the square of the last one in standard deviations; good poses take four."""
FIRST_NOISE = (np.radians(0.1), 0.3)
"""Noise of a flange pose (rad, mm) in the first fit: usual arms."""
LEAST_NOISE = (np.radians(1e-3), 5e-3)
"""Least noise of a flange pose (rad, mm): no robot is better, and a smaller value makes the weights
singular."""
LEAST_PX = 0.02
"""Least noise of a corner, px."""
WHAT_TO_CHECK = (
    "Check that each row names its own photo, and that the poses are the flange's in the base's frame. "
    "Check their units, the order of the quaternion and the axes of the angles. Neither mat nor camera "
    "may move."
)
"""Advice for poses that disagree with the pictures."""


@dataclass(frozen=True, kw_only=True)
class MatView:
    """A picture's corners of the mat (mm, px), the mat's initial pose in the camera's frame, and the flange's
    pose. The last is None if the mat lay at its place before a camera at rest.
    """

    name: str
    corners_mm: Float[np.ndarray, "n 3"]
    corners_px: Float[np.ndarray, "n 2"]
    camera_from_mat: Float[np.ndarray, "4 4"]
    base_from_flange: Float[np.ndarray, "4 4"] | None


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A pinhole with one radial term, from the pictures alone: focal length and middle (px), k1."""

    focal_px: float
    middle_px: tuple[float, float]
    k1: float


@dataclass(frozen=True)
class _Fit:
    """Frames A, W and, with pictures of the mat at its place, Y; the lens (f, k1, cx, cy)."""

    frames: tuple[Float[np.ndarray, "4 4"], ...]
    lens: Float[np.ndarray, "4"]

    def moved(self, step: Float[np.ndarray, " p"]) -> "_Fit":
        """The fit after small motions (rad, mm) of each frame in its own axes, and a change of the lens."""
        parts = step[:-4].reshape(-1, 6)
        frames = tuple(frame @ small_motion(part) for frame, part in zip(self.frames, parts, strict=True))
        return _Fit(frames, self.lens + step[-4:])


@dataclass(frozen=True)
class _Equations:
    """Linear equations of all corners about a fit; QR factors compress those of each picture.

    Picture i: y = X step + T off + noise of `px`, with the flange's error `off` (rad, mm) and T (6, 6).
    `rest`, `rest_y`: the equations without an error of the flange.
    """

    T: Float[np.ndarray, "n 6 6"]
    X: Float[np.ndarray, "n 6 p"]
    y: Float[np.ndarray, "n 6"]
    rest: Float[np.ndarray, "r p"]
    rest_y: Float[np.ndarray, " r"]
    px: float

    def without(self, part: Int[np.ndarray, " _"]) -> "_Equations":
        """The equations without some pictures; `rest`, which determines lens and tilt, stays."""
        keep = np.delete(np.arange(len(self.y)), part)
        return replace(self, T=self.T[keep], X=self.X[keep], y=self.y[keep])

    def solved(
        self, noise: Float[np.ndarray, "2"]
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"], float]:
        """The step by generalised least squares, its covariance, and -2 times the restricted log likelihood
        of the flange's noise (rad, mm) (Patterson and Thompson 1971, Biometrika 58:545).
        """
        root = self.T * np.repeat(noise, 3)
        spread = root @ np.swapaxes(root, 1, 2) + self.px**2 * np.eye(6)
        lower = np.linalg.cholesky(spread)
        white = np.linalg.solve(lower, np.concatenate([self.X, self.y[..., None]], axis=2))
        X = np.concatenate([white[..., :-1].reshape(-1, self.X.shape[2]), self.rest / self.px])
        y = np.concatenate([white[..., -1].ravel(), self.rest_y / self.px])
        basis, size, right = np.linalg.svd(X, full_matrices=False)
        step = right.T @ ((basis.T @ y) / size)
        logs = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() + 2 * np.log(size).sum()
        return step, (right.T / size**2) @ right, float(logs + np.sum((y - X @ step) ** 2))


def hand_eye(views: Sequence[MatView], lens: Lens, *, camera_on_flange: bool, source: str) -> BaseAndMat:
    """base_from_mat by maximum likelihood over all corners (px), both frames and the lens.

    Each flange pose has an unknown normal error; the residuals determine its standard deviations of rotation
    and position. The error is eliminated: the corners of one picture share a covariance px² I + J S J'.
    Raises TactileFailure for too few or too similar poses, and for poses that disagree with the pictures.
    """
    moving = [view for view in views if view.base_from_flange is not None]
    still = [view for view in views if view.base_from_flange is None]
    poses = np.array([view.base_from_flange for view in moving]).reshape(-1, 4, 4)
    require_turns(poses, fewest=FEWEST_POSES, source=source)
    if camera_on_flange == bool(still):
        observed = "rows without a pose" if still else "no row without a pose"
        expected = "none with a camera on the flange" if still else "a photo of the mat at its place"
        advice = "Rows without a pose belong to a camera at rest (docs/how-to/connect-your-gripper.md)."
        raise refused(source, observed, expected, advice)
    frames, miss_mm = _closed_form(moving, np.linalg.inv(poses) if camera_on_flange else poses)
    if not miss_mm < MOST_START_MM:
        observed = f"poses that miss the mat's corners in the photos by {miss_mm:.3g} mm"
        expected = f"at most {MOST_SD_MM:g} mm and {MOST_SD_DEG:g} degrees"
        raise refused(source, observed, expected, WHAT_TO_CHECK)
    frames = (*frames, *(frames[0] @ view.camera_from_mat for view in still[:1]))
    start = _Fit(frames, np.array([lens.focal_px, lens.k1, *lens.middle_px]))
    fit, equations, noise = _fitted(moving, still, start, camera_on_flange=camera_on_flange, source=source)
    off = np.linalg.solve(equations.T, equations.y[..., None])[..., 0]
    names = [view.name for view in moving]
    require_noise(names, off[:, 3:], np.degrees(off[:, :3]), source=source, advice=WHAT_TO_CHECK)
    free = 3 * len(moving) - 6
    student = free / (free - 2)  # the variance of Student's t over the normal's
    covariance = student * equations.solved(noise)[1]
    ahead = []
    for part in folds(len(moving)):
        step = equations.without(part).solved(noise)[0]
        misses = equations.y[part] - equations.X[part] @ step
        ahead.append(np.linalg.solve(equations.T[part], misses[..., None])[..., 0])
    heldout = np.sqrt(np.mean(np.concatenate(ahead).reshape(-1, 2, 3) ** 2, axis=(0, 2)))
    last = 6 * (len(fit.frames) - 1)
    return BaseAndMat(
        base_from_mat=fit.frames[-1],
        covariance=covariance[last : last + 6, last : last + 6],
        flange_sd_mm=float(noise[1]),
        flange_sd_deg=float(np.degrees(noise[0])),
        heldout_mm=float(heldout[1]),
        heldout_deg=float(np.degrees(heldout[0])),
        pixel_sd=equations.px,
        poses=len(moving),
        other_name="flange_from_camera" if camera_on_flange else "base_from_camera",
        other=fit.frames[0],
    )


def _closed_form(
    views: Sequence[MatView], known: Float[np.ndarray, "n 4 4"]
) -> tuple[tuple[Float[np.ndarray, "4 4"], ...], float]:
    """A and W of camera_from_mat = inv(A) @ known @ W, and the corners' root mean square miss (mm).

    Rotations from the dominant singular vectors of the sum of Kronecker products, then shifts by linear least
    squares (Shah 2013, J. Mech. Robot. 5:031007).
    """
    seen = np.array([view.camera_from_mat for view in views])
    turns, turned = seen[:, :3, :3], known[:, :3, :3]
    left, _, right = np.linalg.svd(
        np.einsum("nab,ncd->acbd", turned, turns).reshape(9, 9), full_matrices=False
    )
    mat_from_known, camera_from_known = (
        _nearest_rotation(vector.reshape(3, 3, order="F")) for vector in (right[0], left[:, 0])
    )
    design = np.concatenate([turns, np.broadcast_to(-np.eye(3), turns.shape)], axis=2).reshape(-1, 6)
    wanted = (known[:, :3, 3] @ camera_from_known.T - seen[:, :3, 3]).ravel()
    shifts = np.linalg.lstsq(design, wanted, rcond=None)[0]
    A = np.linalg.inv(rigid(camera_from_known, shifts[3:]))
    W = np.linalg.inv(rigid(mat_from_known, shifts[:3]))
    misses = [
        np.sum(
            (_moved(np.linalg.inv(A) @ k @ W, v.corners_mm) - _moved(v.camera_from_mat, v.corners_mm)) ** 2, 1
        )
        for k, v in zip(known, views, strict=True)
    ]
    return (A, W), float(np.sqrt(np.mean(np.concatenate(misses))))


def _fitted(
    moving: Sequence[MatView],
    still: Sequence[MatView],
    fit: _Fit,
    *,
    camera_on_flange: bool,
    source: str,
) -> tuple[_Fit, _Equations, Float[np.ndarray, "2"]]:
    """The fit, its equations and the flange's noise (rad, mm); each Gauss-Newton step estimates it again."""
    noise = np.array(FIRST_NOISE)
    for _ in range(MOST_STEPS):
        equations = _equations(moving, still, fit, camera_on_flange=camera_on_flange)
        noise = _noise_of(equations, noise)
        step, covariance, _ = equations.solved(noise)
        if step @ np.linalg.solve(covariance, step) < CONVERGED:
            return fit, equations, noise
        fit = fit.moved(step)
    raise refused(source, "poses and photos to which no fit converges", "poses that agree", WHAT_TO_CHECK)


def _linear(
    view: MatView, fit: _Fit, camera_on_flange: bool
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m 6"], Float[np.ndarray, "m p"]]:
    """Residual pixels of one picture, and derivatives of the predicted pixels: by a motion of the flange in
    its axes (0 if the mat lies at its place), and by a step of the fit.
    """
    camera = np.linalg.inv(fit.frames[0])
    mat_frame = 2 if view.base_from_flange is None else 1
    after = fit.frames[mat_frame]
    if view.base_from_flange is not None and camera_on_flange:
        after = np.linalg.inv(view.base_from_flange) @ after
    elif view.base_from_flange is not None:
        camera = camera @ view.base_from_flange
    at_flange = _moved(after, view.corners_mm)
    local = _moved(camera, at_flange)
    xy, z = local[:, :2] / local[:, 2:], local[:, 2:, None]
    focal, k1, *middle = fit.lens
    square = np.sum(xy**2, axis=1, keepdims=True)
    bent = (1 + k1 * square) * xy
    miss = view.corners_px - focal * bent - middle
    by_xy = focal * ((1 + k1 * square)[..., None] * np.eye(2) + 2 * k1 * xy[:, :, None] * xy[:, None, :])
    by_local = by_xy @ np.concatenate([np.broadcast_to(np.eye(2), (len(xy), 2, 2)), -xy[..., None]], 2) / z
    by_fit = np.zeros((len(xy), 2, 6 * len(fit.frames) + 4))
    by_fit[..., :6] = -by_local @ motion_slopes(local)
    by_fit[..., 6 * mat_frame : 6 * mat_frame + 6] = (
        by_local @ (camera @ after)[:3, :3] @ motion_slopes(view.corners_mm)
    )
    by_fit[..., -4], by_fit[..., -3] = bent, focal * square * xy
    by_fit[:, [0, 1], [-2, -1]] = 1.0
    by_flange = by_local @ camera[:3, :3] @ motion_slopes(at_flange) * (view.base_from_flange is not None)
    return miss.ravel(), by_flange.reshape(-1, 6), by_fit.reshape(2 * len(xy), -1)


def _equations(
    moving: Sequence[MatView], still: Sequence[MatView], fit: _Fit, *, camera_on_flange: bool
) -> _Equations:
    """The corners' equations about `fit`. Residuals that no motion of a picture removes are corner noise."""
    lines = [_linear(view, fit, camera_on_flange) for view in moving]
    R = [_triangle(np.column_stack([by_flange, by_fit, miss])) for miss, by_flange, by_fit in lines]
    top = np.array([factor[:6] for factor in R])
    at_rest = [_linear(view, fit, camera_on_flange) for view in still]
    still_rows = [np.column_stack([by_fit, miss]) for miss, _, by_fit in at_rest]
    squares = [np.sum((m - s @ np.linalg.lstsq(s, m, rcond=None)[0]) ** 2) for m, s, _ in lines]
    free = sum(len(miss) - 6 for miss, *_ in lines) - 4
    rest = _triangle(np.concatenate([*(factor[6:, 6:] for factor in R), *still_rows]))
    return _Equations(
        T=top[:, :, :6],
        X=top[:, :, 6:-1],
        y=top[:, :, -1],
        rest=rest[:, :-1],
        rest_y=rest[:, -1],
        px=max(float(np.sqrt(sum(squares) / free)), LEAST_PX),
    )


def _triangle(matrix: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "l k"]:
    """R of the QR factors: the same least-squares problem in fewer rows."""
    return np.asarray(np.linalg.qr(matrix)[1])


def _noise_of(equations: _Equations, start: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """The flange's noise per axis (rad, mm) of greatest restricted likelihood."""

    def minus_likelihood(logs: Float[np.ndarray, "2"]) -> float:
        return equations.solved(np.exp(logs))[2]

    best = minimize(
        minus_likelihood,
        [float(np.log(sd)) for sd in start],
        method="L-BFGS-B",
        bounds=[(float(np.log(least)), float(np.log(1e4 * least))) for least in LEAST_NOISE],
        tol=1e-6,
    )
    return np.asarray(np.exp(best.x))


def _moved(pose: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation nearest to a matrix of unknown sign (a singular vector's sign is arbitrary)."""
    left, _, right = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    return np.asarray(left @ right)
