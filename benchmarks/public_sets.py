"""Public sets of photos of real objects, read as recon takes them: image, camera, and a mask by colour.

Nothing here is part of the product: these objects stand before a dark or a blue cloth, where a threshold
finds them, and their cameras are published. Only the marker boards go the product's own way.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy import ndimage
from scipy.io import loadmat
from scipy.linalg import rq

from recon.cameras.camera import Camera
from recon.cameras.photos import Photo, read_photo
from recon.cameras.printed_mat import Mat
from recon.silhouettes.mask import Window

BRIGHT = {"dino": 48, "temple": 70}
"""Grey levels, of the brightest channel, above which a pixel is the object. 48 of 255 is the 0.19 that the
authors of the sets advise; the cloth under the temple is brighter than that in many views."""
RED_LESS_BLUE = {"dino_Ps.mat": -15, "viff.xml": 12}
"""Grey levels above which a pixel is the object: percentile 75 of the first picture, which is still cloth, is
-42 in the blue set and 3 in the black one, and the median of the object about 80."""
RED_RATIO, DARKEST = 1.35, 8.0
"""Red over the larger of green and blue: 1.5 and more on the brick's face in shade, 1.25 on the wooden table,
1.1 on paper lit by the brick (three photos, looked at). Below DARKEST grey levels the ratio is noise."""
BORDER_PX = 3
RING = 300.0
"""Distance of the cameras from their middle where no unit is published: about that to a fruit, in mm."""


@dataclass(frozen=True)
class View:
    """A photo's window, its camera, where the object is in it, and whether it holds the object whole."""

    window: Window
    camera: Camera
    mask: np.ndarray
    whole: bool


@dataclass(frozen=True)
class PublicSet:
    """Views in a frame with z up; the published box of the object, mm, where there is one."""

    views: tuple[View, ...]
    unit: str
    box: np.ndarray | None


@dataclass(frozen=True)
class Board:
    """A marker board as its authors give it (corners in its own units, y down), and whether the brick is on
    it.
    """

    dictionary: str
    corners: dict[int, tuple[tuple[float, float], ...]]
    middle: tuple[float, float]
    unit_mm: float
    photos: str
    brick: bool

    def mat(self) -> Mat:
        """The board as recon's mat: mm, z up, origin in the middle, corners top-left first and clockwise."""
        x0, y0 = self.middle
        corners = {
            tag: np.array([((x - x0) * self.unit_mm, (y0 - y) * self.unit_mm, 0.0) for x, y in square])
            for tag, square in self.corners.items()
        }
        width, height = 2 * np.abs(np.concatenate(list(corners.values()))).max(0)[:2]
        return Mat(self.dictionary, corners, float(width), float(height))


def _square(x: float, y: float, side: float) -> tuple[tuple[float, float], ...]:
    return ((x, y), (x + side, y), (x + side, y + side), (x, y + side))


_DUPLO_PLACES = [
    *((20.0 * i, 0.0) for i in range(6)),
    *((x, y) for y in (20.0, 40.0) for x in (0.0, 100.0)),
    *((20.0 * i, 60.0) for i in range(6)),
]
_PAGE_PT, _TAG_PT, _MARGIN_PT = (595.276, 841.89), 80.0, 10.0
_LEFT, _RIGHT, _MIDDLE = (
    _MARGIN_PT,
    _PAGE_PT[0] - _MARGIN_PT - _TAG_PT,
    (_PAGE_PT[0] - _TAG_PT) / 2 - _MARGIN_PT,
)
_LOW, _HALF, _HIGH = _MARGIN_PT, (_PAGE_PT[1] - _TAG_PT) / 2 - _MARGIN_PT, _PAGE_PT[1] - _MARGIN_PT - _TAG_PT
_BEAR_PLACES = [
    (_LEFT, _LOW), (_LEFT, _HALF), (_RIGHT, _LOW), (_RIGHT, _HALF),
    (_MIDDLE, _LOW), (_LEFT, _HIGH), (_RIGHT, _HIGH), (_MIDDLE, _HIGH),
]  # fmt: skip
BOARDS = {
    # Kudo510/VoxelCarving: scripts/utils/markerDetector.py, assets/red_block_AR. The board's unit is not
    # told; 2.5 mm fits the brick to 0.3 % and makes the tags 25 mm wide.
    "duplo": Board(
        "ARUCO_ORIGINAL",
        {tag: _square(x, y, 10.0) for tag, (x, y) in enumerate(_DUPLO_PLACES)},
        (55.0, 35.0),
        2.5,
        "assets/red_block_AR/original_images",
        True,
    ),
    # LeoEckert02/ARVoxelCarving: aruco_marker_generation.cpp draws 80 pt tags on A4 and
    # aruco_marker_detection.cpp says that they came out 30 mm wide; resources/u_input. The bear's size is not
    # told.
    "bear": Board(
        "6X6_50",
        {tag: _square(x, _PAGE_PT[1] - y - _TAG_PT, _TAG_PT) for tag, (x, y) in enumerate(_BEAR_PLACES)},
        (_PAGE_PT[0] / 2, _PAGE_PT[1] / 2),
        30.0 / _TAG_PT,
        "resources/u_input",
        False,
    ),
}
BRICK_MM, STUD_MM, STUD_PITCH_MM = (31.8, 31.8, 19.2), (9.35, 4.5), 16.0
"""A Duplo brick 2 x 2: pitch 16 mm less 0.2 mm play, 19.2 mm high; studs' diameter and height (measured
values of cfinke/LEGO.scad)."""


def brick() -> tuple[np.ndarray, np.ndarray]:
    """The Duplo brick as a surface that intersects itself under the studs; mm, z up, on z = 0."""
    parts = [trimesh.creation.box(BRICK_MM)]
    parts[0].apply_translation((0, 0, BRICK_MM[2] / 2))
    for x in (-STUD_PITCH_MM / 2, STUD_PITCH_MM / 2):
        for y in (-STUD_PITCH_MM / 2, STUD_PITCH_MM / 2):
            stud = trimesh.creation.cylinder(STUD_MM[0] / 2, STUD_MM[1] + 1.0, sections=48)
            stud.apply_translation((x, y, BRICK_MM[2] + STUD_MM[1] / 2 - 0.5))
            parts.append(stud)
    whole_brick = trimesh.util.concatenate(parts)
    return np.asarray(whole_brick.vertices, float), np.asarray(whole_brick.faces, int)


def brick_points() -> dict[str, np.ndarray]:
    """Points on the brick's four sides, and on its top with the studs' tops, 0.4 mm apart."""
    (a, _, h), (d, rise) = BRICK_MM, STUD_MM
    at, up = np.arange(-a / 2 + 0.2, a / 2, 0.4), np.arange(0.2, h, 0.4)
    u, z = (g.ravel() for g in np.meshgrid(at, up))
    side = np.stack([u, np.full_like(u, a / 2), z], axis=1)
    turns = [np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    x, y = (g.ravel() for g in np.meshgrid(at, at))
    on_stud = np.hypot(np.abs(x) - STUD_PITCH_MM / 2, np.abs(y) - STUD_PITCH_MM / 2) < d / 2
    return {
        "sides": np.concatenate([side @ t.T for t in turns]),
        "top": np.stack([x, y, h + rise * on_stud], axis=1),
    }


def middlebury(folder: Path) -> PublicSet:
    """dinoRing, templeRing and their kin (Seitz et al. 2006): *_par.txt and the photos anywhere in a folder.

    A line is: name, K by rows, R by rows, t, in metres, y up. Views that *_good_silhouette_images.txt does
    not name have the object in shadow and count as not whole.
    """
    tables = sorted(folder.rglob("*_par.txt"))
    if len(tables) != 1:
        raise SystemExit(f"{folder}: found {len(tables)} files *_par.txt; expected one.")
    good = [p.read_text().split() for p in tables[0].parent.glob("*_good_silhouette_images.txt")]
    least = next(v for k, v in BRIGHT.items() if tables[0].name.startswith(k))
    box = re.search(r"box.*\n\s*\((.*)\)\s*\n\s*\((.*)\)", _readme(tables[0].parent))
    z_up = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    views = []
    for line in tables[0].read_text().splitlines()[1:]:
        name, *numbers = line.split()
        path = next(folder.rglob(name), None)
        if path is None:
            continue
        n = np.array([float(x) for x in numbers])
        image = cv2.imread(str(path))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = n[9:18].reshape(3, 3), n[18:21] * 1000.0
        views.append(
            _view(
                name,
                image,
                image.max(2) > least,
                n[:9].reshape(3, 3),
                pose @ z_up.T,
                not good or name in good[0],
            )
        )
    corners = (
        None if box is None else np.array([[float(x) for x in g.split()] for g in box.groups()]) * 1000.0
    )
    if corners is not None:
        corners = np.sort(corners @ z_up[:3, :3].T, axis=0)
    return PublicSet(tuple(views), "mm", corners)


def vgg(folder: Path) -> PublicSet:
    """A turntable ring with 3 x 4 projection matrices: dino_Ps.mat or viff.xml, and one picture for each.

    The unit is the matrices' own, scaled here so that the cameras are RING from their middle. A ring that
    looks outward is the mirror image of the true one (its matrices have lost their sign), and is mirrored
    back.
    """
    tables = [p for name in RED_LESS_BLUE for p in folder.rglob(name)]
    if not tables:
        raise SystemExit(f"{folder}: neither of {', '.join(RED_LESS_BLUE)} is there.")
    table = tables[0]
    if table.suffix == ".mat":
        matrices = [np.asarray(p, float) for p in loadmat(table)["P"].ravel()]
    else:
        store = cv2.FileStorage(str(table), cv2.FILE_STORAGE_READ)
        names = [f"viff{i:03d}_matrix" for i in range(1000)]
        matrices = [m for n in names if (m := store.getNode(n).mat()) is not None]
    numbered = {_number(p)[0]: p for p in _pictures(table.parent)}
    views = []
    for i, (K, pose) in enumerate(_ring(matrices)):
        image = cv2.imread(str(numbered[i]))
        difference = image[..., 2].astype(np.float32) - image[..., 0]
        mask = cv2.GaussianBlur(difference, (3, 3), 0.8) > RED_LESS_BLUE[table.name]
        views.append(_view(numbered[i].name, image, mask, K, pose, True))
    return PublicSet(tuple(views), "unit", None)


def board_photos(folder: Path, board: Board) -> list[Photo]:
    """The photos of a board set (.jpg whose content may be PNG)."""
    return [read_photo(p) for p in _pictures(folder / board.photos)]


def red_mask(image: np.ndarray) -> np.ndarray:
    """The red brick: red RED_RATIO times the larger of green and blue, in light and in shade."""
    f = cv2.GaussianBlur(image.astype(np.float32), (3, 3), 0.8)
    return _largest(f[..., 2] > RED_RATIO * np.maximum(f[..., :2].max(2), DARKEST))


def whole(mask: np.ndarray) -> bool:
    """Whether a mask keeps off the picture's border."""
    inner = mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    return bool(inner.any() and inner.sum() == mask.sum())


def _view(
    name: str, image: np.ndarray, mask: np.ndarray, K: np.ndarray, pose: np.ndarray, good: bool
) -> View:
    """The view as a camera of recon's would have it: one focal length, the principal point in the middle.

    With x' = f K^-1 x the picture is stretched and shifted (K is triangular: an affine map). The middle may
    lie off the picture; the window says where in it the picture lies.
    """
    mask = _largest(mask)
    K = K / K[2, 2]
    f = float(K[0, 0])
    A = np.diag([f, f, 1.0]) @ np.linalg.inv(K)
    rows, columns = mask.shape
    corners = np.array([[0, 0, 1], [columns - 1, 0, 1], [0, rows - 1, 1], [columns - 1, rows - 1, 1]]) @ A.T
    low, high = np.floor(corners[:, :2].min(0)), np.ceil(corners[:, :2].max(0))
    reach = np.abs(np.stack([low, high])).max(0)
    size = tuple((high - low + 1).astype(int).tolist())
    A[:2, 2] -= low
    moved = cv2.warpAffine(image, A[:2], size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    shape = cv2.warpAffine(mask.astype(np.float32), A[:2], size, flags=cv2.INTER_LINEAR) > 0.5
    camera = Camera(
        name=name, width_px=int(2 * reach[0]) + 1, height_px=int(2 * reach[1]) + 1, focal_px=f, k1=0.0,
        cam_from_world=pose,
    )  # fmt: skip
    corner = tuple((low + reach).astype(int).tolist())
    return View(Window(moved, corner, 1), camera, shape, good and whole(mask))


def _ring(matrices: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """K and pose of each matrix, all looking inward, RING from their middle."""
    for mirror in (np.eye(4), np.diag([-1.0, 1.0, 1.0, 1.0])):
        parts = [_parts(np.asarray(P, float) @ mirror) for P in matrices]
        places = np.array([-pose[:3, :3].T @ pose[:3, 3] for _, pose in parts])
        middle = places.mean(0)
        if np.mean([(pose[:3, :3] @ middle + pose[:3, 3])[2] for _, pose in parts]) > 0:
            break
    scale = RING / float(np.linalg.norm(places - middle, axis=1).mean())
    for _, pose in parts:
        pose[:3, 3] *= scale
    return parts


def _parts(P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K with a positive diagonal and the rigid motion of a projection matrix."""
    K, R = rq(P[:, :3])
    turn = np.diag(np.sign(np.diag(K)))
    K, R = K @ turn, turn @ R
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, np.linalg.solve(K, P[:, 3])
    if np.linalg.det(R) < 0:
        pose[:3] *= -1
    return K, pose


def _largest(mask: np.ndarray) -> np.ndarray:
    """The largest part of a mask, holes closed (an outline of recon's has none)."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    parts, _ = ndimage.label(opened)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    return np.asarray(ndimage.binary_fill_holes(parts == sizes.argmax()))


def _pictures(folder: Path) -> list[Path]:
    found = [p for p in folder.iterdir() if p.suffix.lower() in (".jpg", ".jpeg", ".png", ".ppm")]
    return sorted((p for p in found if re.search(r"\d", p.stem)), key=_number)


def _number(path: Path) -> tuple[int, str]:
    return int(re.findall(r"\d+", path.stem)[-1]), path.name


def _readme(folder: Path) -> str:
    return "\n".join(p.read_text(errors="replace") for p in sorted(folder.glob("README*")))


def spread(places: Sequence[np.ndarray], count: int) -> list[int]:
    """`count` of the places, each as far from those before as can be, seen from their common middle."""
    rays = np.array(places) - np.mean(places, axis=0)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    chosen = [0]
    near = rays @ rays[0]
    while len(chosen) < min(count, len(rays)):
        chosen.append(int(near.argmin()))
        near = np.maximum(near, rays @ rays[chosen[-1]])
    return sorted(chosen)
