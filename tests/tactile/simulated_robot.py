"""A robot with known frames that photographs a mat, with noise of known size."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tactile.robot.hand_eye import Lens, MatView

FOCAL_PX, MIDDLE_PX, K1 = 1400.0, (803.0, 596.0), -0.05
"""px, px, 1: the middle is some pixels beside that of 1600 x 1200 pixels."""
NOISE_MM, NOISE_DEG, NOISE_PX = 0.1, 0.05, 0.2
"""Per axis, of a flange pose and of a corner."""


def pose(x: float, y: float, z: float, *turn_deg: float) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3] = Rotation.from_euler("xyz", turn_deg or (0.0, 0.0, 0.0), degrees=True).as_matrix()
    made[:3, 3] = x, y, z
    return made


BASE_FROM_MAT = pose(520.0, -140.0, 35.0, 1.0, -0.7, 63.0)
FLANGE_FROM_CAMERA = pose(4.0, -62.0, 48.0, -9.0, 3.0, 88.0)


def tags(half: int = 3) -> np.ndarray:
    """Corners of 18 mm tags on a grid of 23 mm around a blank middle (mm)."""
    square = np.array([[-9.0, 9, 0], [9, 9, 0], [9, -9, 0], [-9, -9, 0]])
    cells = [
        (x, y) for x in range(-half, half + 1) for y in range(-half, half + 1) if max(abs(x), abs(y)) == half
    ]
    return np.concatenate([square + 23.0 * np.array([x, y, 0]) for x, y in cells])


def looking_down(rng: np.random.Generator, count: int, tilt_deg: float = 35.0) -> list[np.ndarray]:
    """Cameras (mat_from_camera) above the mat, 260 to 380 mm away, tilted by up to `tilt_deg`."""
    made = []
    for k in range(count):
        way, tilt = 2 * np.pi * k / count, np.radians(tilt_deg * rng.uniform(0.5, 1.0))
        ahead = -np.array([np.cos(way) * np.sin(tilt), np.sin(way) * np.sin(tilt), np.cos(tilt)])
        right = np.cross(ahead, [np.cos(way / 3), np.sin(way / 3), 0.0])
        right /= np.linalg.norm(right)
        at = np.eye(4)
        at[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
        at[:3, 3] = rng.uniform(-15, 15, 3) - rng.uniform(260, 380) * ahead
        made.append(at)
    return made


def noisy(flange: np.ndarray, rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """The flange's pose as the controller reports it."""
    turn = Rotation.from_rotvec(scale * rng.normal(0, NOISE_DEG, 3), degrees=True).as_matrix()
    off = np.eye(4)
    off[:3, :3], off[:3, 3] = turn, scale * rng.normal(0, NOISE_MM, 3)
    return flange @ off


def pictured(camera_from_mat: np.ndarray, corners_mm: np.ndarray) -> np.ndarray:
    """Pixels, by OpenCV's projection."""
    K = np.array([[FOCAL_PX, 0, MIDDLE_PX[0]], [0, FOCAL_PX, MIDDLE_PX[1]], [0, 0, 1]])
    turn = cv2.Rodrigues(camera_from_mat[:3, :3])[0]
    return cv2.projectPoints(corners_mm, turn, camera_from_mat[:3, 3], K, np.array([K1, 0, 0, 0.0]))[0][:, 0]


def view(
    name: str, camera_from_mat: np.ndarray, flange: np.ndarray | None, corners: np.ndarray, rng, scale=1.0
) -> MatView:
    """What the calibration gets, the start of its pose by OpenCV's solver for planes with a rough lens."""
    px = pictured(camera_from_mat, corners) + scale * rng.normal(0, NOISE_PX, (len(corners), 2))
    (x, y), f = LENS.middle_px, LENS.focal_px
    K = np.array([[f, 0, x], [0, f, y], [0, 0, 1]])
    _, turn, shift = cv2.solvePnP(corners, px, K, None, flags=cv2.SOLVEPNP_IPPE)
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return MatView(
        name=name, corners_mm=corners, corners_px=px, camera_from_mat=start, base_from_flange=flange
    )


LENS = Lens(focal_px=1405.0, middle_px=(799.5, 599.5), k1=0.0)
"""What pictures alone would give: the focal length to 0.4 %, the middle of the picture."""


def photographs_of_a_carried_mat(rng, count: int = 16):
    """Views of a camera at rest: the mat on the flange, then the mat at its place."""
    corners, looks = tags(2), looking_down(rng, count + 1)
    base_from_camera = BASE_FROM_MAT @ looks[0]
    flange_from_mat = pose(10.0, -4.0, 120.0, 178.0, 3.0, 20.0)
    made = []
    for k, mat_from_camera in enumerate(looks[1:]):
        flange = base_from_camera @ np.linalg.inv(mat_from_camera) @ np.linalg.inv(flange_from_mat)
        made.append(view(f"{k:02d}.png", np.linalg.inv(mat_from_camera), noisy(flange, rng), corners, rng))
    return [*made, view("place.png", np.linalg.inv(looks[0]), None, corners, rng)]


def photographs(rng, count: int = 16, *, scale: float = 1.0, tilt_deg: float = 35.0, half: int = 2):
    """Views of a camera on the flange, and the true flange poses."""
    corners, true = tags(half), []
    views = []
    for k, mat_from_camera in enumerate(looking_down(rng, count, tilt_deg)):
        flange = BASE_FROM_MAT @ mat_from_camera @ np.linalg.inv(FLANGE_FROM_CAMERA)
        true.append(flange)
        reported = noisy(flange, rng, scale)
        views.append(view(f"{k:02d}.png", np.linalg.inv(mat_from_camera), reported, corners, rng, scale))
    return views, true
