"""Faults of photos, as arrays: what hands, cameras, cables and software do to a good picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

Picture = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class TrueView:
    """Where a photo was really taken from: x_cam = R x + t (OpenCV axes), pinhole K with one radial term."""

    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, "3"]
    K: Float[np.ndarray, "3 3"]

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of world points."""
        seen = (points @ self.R.T + self.t) @ self.K.T
        return np.asarray(seen[:, :2] / seen[:, 2:])

    def depth(self, point: Float[np.ndarray, "3"]) -> float:
        """Distance along the optical axis."""
        return float((self.R @ point + self.t)[2])

    @property
    def azimuth_deg(self) -> float:
        """Direction from the fruit to the camera, seen from above."""
        place = -self.R.T @ self.t
        return float(np.degrees(np.arctan2(place[1], place[0])))


def blurred(image: Picture, sigma_px: float) -> Picture:
    """Out of focus."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8)


def shaken(image: Picture, length_px: int) -> Picture:
    """Moved sideways while the shutter was open."""
    return np.asarray(cv2.filter2D(image, -1, np.full((1, length_px), 1 / length_px)), np.uint8)


def exposed(image: Picture, stops: float) -> Picture:
    """Light times 2^stops, clipped (display gamma 2.2)."""
    linear = (image.astype(np.float32) / 255) ** 2.2 * 2.0**stops
    return np.asarray(255 * np.clip(linear, 0, 1) ** (1 / 2.2) + 0.5, np.uint8)


def toned(image: Picture, gamma: float) -> Picture:
    """Display values to the power of `gamma`."""
    levels = np.clip(255 * (np.arange(256) / 255) ** gamma + 0.5, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, levels), np.uint8)


def tinted(image: Picture, factors: Sequence[float]) -> Picture:
    """Blue, green and red times so much: another white balance, or less light."""
    return np.asarray(np.clip(image * np.array(factors) + 0.5, 0, 255), np.uint8)


def recoloured(image: Picture, fruit: Bool[np.ndarray, "h w"], factors: Sequence[float]) -> Picture:
    """The fruit's light without its colour, times blue, green and red."""
    soft = cv2.GaussianBlur(fruit.astype(np.float32), (0, 0), 0.6)[..., None]
    light = (image.astype(np.float32) / 255) ** 2.2
    skin = light.mean(axis=2, keepdims=True) * np.array(factors, np.float32)
    mixed = np.clip(light * (1 - soft) + skin * soft, 0, 1)
    return np.asarray(255 * mixed ** (1 / 2.2) + 0.5, np.uint8)


def shaded(
    image: Picture,
    view: TrueView,
    fruit: Bool[np.ndarray, "h w"],
    skin: Float[np.ndarray, "n 3"],
    *,
    azimuth: float,
    light: float = 0.35,
) -> Picture:
    """A sharp shadow of the fruit on z = 0, away from a lamp 35 degrees up at `azimuth` (rad), where a share
    `light` of the light is left.
    """
    away = -np.array([np.cos(azimuth), np.sin(azimuth)]) / np.tan(np.radians(35))
    cast = np.column_stack([skin[:, :2] + skin[:, 2:] * away, np.zeros(len(skin))])
    dark = np.zeros(image.shape[:2], np.uint8)
    hull = cv2.convexHull(view.project(cast).astype(np.float32))
    cv2.fillConvexPoly(dark, np.rint(hull * 16).astype(np.int32), 1, shift=4)
    share = cv2.GaussianBlur(dark.astype(np.float32), (0, 0), 1.0)
    share *= 1 - cv2.GaussianBlur(fruit.astype(np.float32), (0, 0), 0.6)
    linear = (image.astype(np.float32) / 255) ** 2.2 * (1 - (1 - light) * share[..., None])
    return np.asarray(255 * linear ** (1 / 2.2) + 0.5, np.uint8)


def vignetted(image: Picture, corner: float) -> Picture:
    """Light falls off to `corner` of the middle's in the corners."""
    rows, columns = image.shape[:2]
    v, u = np.mgrid[:rows, :columns]
    r2 = ((u - columns / 2) ** 2 + (v - rows / 2) ** 2) / ((columns**2 + rows**2) / 4)
    return np.asarray(image * (1 - (1 - corner) * r2)[..., None] + 0.5, np.uint8)


def grey(image: Picture) -> Picture:
    """Without colour."""
    return np.asarray(cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), np.uint8)


def zoomed(image: Picture, factor: float) -> Picture:
    """The same size in pixels with another focal length."""
    rows, columns = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), 0, factor)
    return np.asarray(cv2.warpAffine(image, matrix, (columns, rows), flags=cv2.INTER_CUBIC), np.uint8)


def aimed_aside(image: Picture, view: TrueView, degrees: float) -> Picture:
    """The camera turned about its own centre (H = K R K^-1, exact); what it had not seen is wood-brown."""
    turn = cv2.Rodrigues(np.radians([0.0, degrees, 0.0]))[0]
    H = view.K @ turn @ np.linalg.inv(view.K)
    return np.asarray(cv2.warpPerspective(image, H, image.shape[1::-1], borderValue=(60, 90, 120)), np.uint8)


def another_scene(image: Picture, seed: int) -> Picture:
    """Blotches of colour: a photo that got into the folder by mistake."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 255, (12, 16, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(small, image.shape[1::-1], interpolation=cv2.INTER_CUBIC), np.uint8)


def covered_mat(image: Picture, view: TrueView, fruit: Bool[np.ndarray, "h w"], past_mm: float) -> Picture:
    """A sheet of white paper on the mat where x is below `past_mm`; the fruit stands before it."""
    sheet = np.array([(-140, -140, 0), (past_mm, -140, 0), (past_mm, 140, 0), (-140, 140, 0)], float)
    out = image.copy()
    cv2.fillPoly(out, [np.rint(view.project(sheet)).astype(np.int32)], (225, 228, 230), cv2.LINE_AA)
    out[fruit] = image[fruit]
    return out


def second_fruit(
    image: Picture, view: TrueView, fruit: Bool[np.ndarray, "h w"], at_mm: Sequence[float], centre_mm: float
) -> Picture:
    """The fruit's own picture once more, where a twin at `at_mm` (x, y) would be seen; the nearer hides."""
    out = pasted(image, image, view, fruit, at_mm=at_mm, centre_mm=centre_mm, size=1.0)
    nearer = view.depth(np.array([0, 0, centre_mm])) < view.depth(np.array([*at_mm, centre_mm]))
    if nearer:
        out[fruit] = image[fruit]
    return out


def without_fruit(image: Picture, fruit: Bool[np.ndarray, "h w"]) -> Picture:
    """The fruit painted over from around it."""
    wide = cv2.dilate(fruit.astype(np.uint8), np.ones((9, 9), np.uint8))
    return np.asarray(cv2.inpaint(image, wide, 5, cv2.INPAINT_TELEA), np.uint8)


def pasted(
    onto: Picture,
    source: Picture,
    view: TrueView,
    fruit: Bool[np.ndarray, "h w"],
    *,
    at_mm: Sequence[float],
    centre_mm: float,
    size: float,
) -> Picture:
    """The fruit cut out of `source` and pasted as if it stood at `at_mm` and were `size` times as large.

    To first order: the cut-out is moved and scaled with the picture of the fruit's centre.
    """
    home, place = np.array([0, 0, centre_mm]), np.array([at_mm[0], at_mm[1], centre_mm * size])
    factor = size * view.depth(home) / view.depth(place)
    before, after = view.project(np.stack([home, place]))
    matrix = np.array(
        [[factor, 0, after[0] - factor * before[0]], [0, factor, after[1] - factor * before[1]]]
    )
    shape = onto.shape[1::-1]
    soft = cv2.GaussianBlur(fruit.astype(np.float32), (3, 3), 0.6)
    alpha = cv2.warpAffine(soft, matrix, shape, flags=cv2.INTER_LINEAR)[..., None]
    moved = cv2.warpAffine(source, matrix, shape, flags=cv2.INTER_CUBIC)
    return np.asarray(alpha * moved + (1 - alpha) * onto + 0.5, np.uint8)
