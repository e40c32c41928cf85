"""A textured egg on a marker mat on a table, seen by ray casting: photos whose truth is a closed form."""

from dataclasses import dataclass

import cv2
import numpy as np
from level_camera import camera_at, direction

from recon.cameras.camera import Camera
from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat, tag_bits

FAR = (120.0, 115.0, 110.0)
WOOD = (70.0, 105.0, 140.0)
"""Colours (blue, green, red) beyond the table and of the table."""
MIDDLE = np.array([0.0, 0.0, 22.0])
"""Where cameras look at, mm."""


@dataclass(frozen=True, kw_only=True)
class Egg:
    """An ellipsoid that stands on z = 0 (semi-axes in mm)."""

    semi_mm: tuple[float, float, float] = (27.0, 25.0, 24.0)
    x_mm: float = 2.0
    y_mm: float = -1.5

    @property
    def centre(self) -> np.ndarray:
        return np.array([self.x_mm, self.y_mm, self.semi_mm[2]])

    @property
    def volume_mm3(self) -> float:
        return float(4 / 3 * np.pi * np.prod(self.semi_mm))

    def covers(self, camera: Camera, pixels: np.ndarray) -> np.ndarray:
        """Whether rays through pixels (n, 2) meet it: the discriminant of the ray's quadratic in it."""
        local = np.column_stack([(pixels - camera.middle_px) / camera.focal_px, np.ones(len(pixels))])
        start = (camera.place - self.centre) / self.semi_mm
        rays = local @ camera.cam_from_world[:3, :3] / self.semi_mm
        return (rays @ start) ** 2 > np.sum(rays**2, axis=1) * (start @ start - 1)

    def misses_mm(self, points: np.ndarray) -> np.ndarray:
        """Signed distance to first order, positive outside."""
        local = (points - self.centre) / np.array(self.semi_mm)
        size = np.linalg.norm(local, axis=1)
        return (size - 1) * size / np.linalg.norm(local / np.array(self.semi_mm), axis=1)


PX_PER_MM = 4
INK, PAPER = 35, 225


@dataclass(frozen=True)
class Board:
    """How tags are printed: border in cells, quarter turns against OpenCV's, squares at the corners."""

    mat: Mat
    border: int = 1
    turns: int = 0
    square_mm: float = 0.0

    def page(self) -> np.ndarray:
        """The print, 4 px to the mm."""
        mat = self.mat
        size = round(mat.height_mm * PX_PER_MM), round(mat.width_mm * PX_PER_MM)
        page = np.full(size, PAPER, np.uint8)
        for tag, corners in mat.corners_mm.items():
            code = tag_bits(mat.dictionary, tag)[1:-1, 1:-1]
            cells = np.pad(np.rot90(code, self.turns), self.border) * np.uint8(PAPER - INK) + INK
            left, top = (corners[0, :2] * [1, -1] + np.array([mat.width_mm, mat.height_mm]) / 2) * PX_PER_MM
            side, square = round(mat.tag_mm * PX_PER_MM), round(self.square_mm * PX_PER_MM)
            x, y = round(left), round(top)
            page[y : y + side, x : x + side] = cv2.resize(
                cells, (side, side), interpolation=cv2.INTER_NEAREST
            )
            for x0 in (x - square, x + side):
                for y0 in (y - square, y + side):
                    page[y0 : y0 + square, x0 : x0 + square] = INK
        return page


def ring(count: int, *, width: int = 480, height: int = 360, k1: float = 0.0) -> list[Camera]:
    """Cameras at three heights around the mat, all looking at the fruit's middle."""
    cameras = []
    for i in range(count):
        azimuth_deg = 360 * i / count * (1 if count < 8 else 3) + np.degrees(0.1 * i)
        away = (280.0 + 5 * (i % 4)) * direction(azimuth_deg, [20.0, 38.0, 60.0][i % 3])
        how = {"size_px": (width, height), "focal_px": 1.5 * width, "name": f"{i:03d}.png", "k1": k1}
        cameras.append(camera_at(MIDDLE + away, MIDDLE, **how))
    return cameras


def photographed(
    cameras: list[Camera], *, egg: Egg | None, mat: Mat | None, seed: int = 0, page: np.ndarray | None = None
) -> list[Photo]:
    """What the cameras see, four rays a pixel, with a little noise; `page`: a print at 4 px to the mm."""
    rng = np.random.default_rng(seed)
    print_ = Board(mat).page() if mat is not None and page is None else page
    wood = cv2.GaussianBlur(rng.normal(0, 1, (700, 700)), (0, 0), 1.5)
    wood = wood / wood.std()
    waves = rng.normal(size=(24, 3)) * np.repeat([0.25, 0.7, 1.6], 8)[:, None]
    phases = rng.uniform(0, 2 * np.pi, 24)
    photos = []
    for camera in cameras:
        image = _seen(camera, egg, print_, wood, waves, phases)
        image = image + rng.normal(0, 1.5, image.shape)
        photos.append(Photo(camera.name, np.clip(image + 0.5, 0, 255).astype(np.uint8)))
    return photos


def point_map(camera: Camera, egg: Egg, rows: int, columns: int) -> np.ndarray:
    """The world point that each cell of a coarse grid sees."""
    v, u = np.mgrid[:rows, :columns]
    pixels = np.stack([(u + 0.5) * camera.width_px / columns, (v + 0.5) * camera.height_px / rows]) - 0.5
    start, rays = _rays(camera, pixels.reshape(2, -1))
    along = np.minimum(_onto_egg(start, rays, egg), _onto_ground(start, rays))
    return (start[:, None] + np.minimum(along, 2000.0) * rays).T.reshape(rows, columns, 3)


def _rays(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays of pixels (2, n) start, and their unit vectors (3, n)."""
    bent = (pixels - np.asarray(camera.middle_px)[:, None]) / camera.focal_px
    xy = bent
    for _ in range(5 if camera.k1 else 0):
        xy = bent / (1 + camera.k1 * np.einsum("in,in->n", xy, xy))
    world_from_cam = camera.cam_from_world[:3, :3].T
    rays = world_from_cam[:, :2] @ xy + world_from_cam[:, 2:]
    rays /= np.sqrt(np.einsum("in,in->n", rays, rays))
    return camera.place, rays


def _onto_egg(start: np.ndarray, rays: np.ndarray, egg: Egg) -> np.ndarray:
    semi = np.array(egg.semi_mm)
    o, d = (start - egg.centre) / semi, rays / semi[:, None]
    a, b, c = np.einsum("in,in->n", d, d), o @ d, o @ o - 1
    under = b * b - a * c
    hit = under > 0
    along = np.full(len(under), np.inf)
    along[hit] = (-b[hit] - np.sqrt(under[hit])) / a[hit]
    return along


def _onto_ground(start: np.ndarray, rays: np.ndarray) -> np.ndarray:
    return np.where(rays[2] < -1e-6, start[2] / np.maximum(-rays[2], 1e-6), np.inf)


def _seen(camera, egg, page, wood, waves, phases, fine: int = 2) -> np.ndarray:
    rows, columns = camera.height_px * fine, camera.width_px * fine
    v, u = np.mgrid[:rows, :columns]
    start, rays = _rays(camera, (np.stack([u.ravel(), v.ravel()]) + 0.5) / fine - 0.5)
    ground = _onto_ground(start, rays)
    far = ground > 3000
    spot = start[:2, None] + np.where(far, 0.0, ground) * rays[:2]
    grain = 14 * _looked_up(wood, spot + 350, (rows, columns), cv2.BORDER_WRAP)
    colour = np.stack(
        [np.where(far, at_far, wooden + grain) for at_far, wooden in zip(FAR, WOOD, strict=True)]
    )
    if page is not None:
        scale = 4.0
        middle = [[page.shape[1] / 2 - 0.5], [page.shape[0] / 2 - 0.5]]
        ink = _looked_up(page, spot * [[scale], [-scale]] + middle, (rows, columns), cv2.BORDER_CONSTANT)
        on = (ink > 0) & ~far
        for channel, tint in zip(colour, (0.95, 0.98, 1.0), strict=True):
            np.multiply(ink, tint, out=channel, where=on)
    if egg is not None:
        along = _onto_egg(start, rays, egg)
        hit = np.flatnonzero(along < np.inf)
        place = (start[:, None] + along[hit] * rays[:, hit]).T
        normal = (place - egg.centre) / np.array(egg.semi_mm) ** 2
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        turns = (waves.astype(np.float32) * 0.5) @ (place - egg.centre).T.astype(np.float32)
        pattern = np.sin(turns + phases.astype(np.float32)[:, None]).sum(axis=0) / 3.5
        light = 0.62 + 0.38 * np.clip(normal @ np.array([0.3, 0.2, 0.93]), 0, 1)
        skin = np.array([45.0, 60.0, 170.0]) + np.array([8.0, 26.0, 20.0]) * pattern[:, None]
        colour[:, hit] = (skin * light[:, None]).T
    shares = cv2.merge([(np.clip(c, 0, 255) / 255).astype(np.float32).reshape(rows, columns) for c in colour])
    mixed = cv2.resize(
        cv2.pow(shares, 2.2), (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA
    )
    return 255 * cv2.pow(mixed, 1 / 2.2).astype(float)


def _looked_up(picture: np.ndarray, at: np.ndarray, shape: tuple[int, int], border: int) -> np.ndarray:
    x, y = at.astype(np.float32)
    return cv2.remap(picture, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR, borderMode=border).ravel()
