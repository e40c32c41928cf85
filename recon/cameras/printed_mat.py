"""The printed marker mat: corners of its tags, how to read mat.json, how to find the tags in a photo."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree

from recon.picture_values import Picture
from recon.recon_failure import ReconFailure, ReconProblem

TAG_MM, FARTHEST_MM = (3.0, 300.0), 2000.0
"""Sides of tags and their reach, mm, from a 30 mm mat to a poster; `drupe mat` prints 9 and 18 within 95."""
BORDERS = (1, 2)
"""Width of a tag's black border in cells: one in AprilTag's and ArUco's tags, two in Kalibr's grids."""
PLACED, SHARP = 0.3, 0.05
"""Largest distance of corners from the mat's, in sides of a tag, in the right order (a quarter turn: 1), and
with the right border. Rendered tags 16 px wide have up to 0.05. Kalibr's with the wrong border have 0.08 and
more."""
LEAST_SIDE_PX = 30.0
"""A shorter side counts as this long: corners are off by fractions of a pixel, whatever the tag's size."""
_UNITS = ((10.0, "cm"), (25.4, "inches"), (1000.0, "m"))
"""Factors to mm of the units in which a tag's side may have been typed."""


@dataclass(frozen=True)
class Mat:
    """Tags on a plane, mm, z up: `corners_mm[id]` is (4, 3), top-left first, clockwise; blank centre."""

    dictionary: str
    corners_mm: dict[int, Float[np.ndarray, "4 3"]]
    width_mm: float
    height_mm: float

    @property
    def tag_mm(self) -> float:
        """Side of the first tag."""
        corners = next(iter(self.corners_mm.values()))
        return float(np.linalg.norm(corners[1] - corners[0]))


def standard_mat(*, tag_mm: float = 18.0, gap_mm: float = 5.0, margin_mm: float = 17.0) -> Mat:
    """A mat of 7 x 7 tags without the middle 3 x 3, where the fruit stands.

    The default, 40 tags on 190 x 190 mm, fits A4 and Letter paper. Halve `tag_mm` and `gap_mm` for cherries.
    """
    pitch, h = tag_mm + gap_mm, tag_mm / 2
    square = np.array([(-h, h, 0), (h, h, 0), (h, -h, 0), (-h, -h, 0)])
    places = [(x, y) for y in range(3, -4, -1) for x in range(-3, 4) if max(abs(x), abs(y)) > 1]
    corners = {tag: square + pitch * np.array([x, y, 0]) for tag, (x, y) in enumerate(places)}
    side_mm = 7 * pitch - gap_mm + 2 * margin_mm
    return Mat("APRILTAG_36h11", corners, side_mm, side_mm)


def mat_mapping(mat: Mat) -> dict[str, Any]:
    """Content of mat.json for a mat; `parse_mat` reads it."""
    return {
        "W": mat.width_mm,
        "H": mat.height_mm,
        "tag": mat.tag_mm,
        "dict": mat.dictionary,
        "tags": {str(tag): corners.tolist() for tag, corners in mat.corners_mm.items()},
        "n": len(mat.corners_mm),
    }


def parse_mat(mapping: Mapping[str, Any], *, source: str) -> Mat:
    """The mat that mat.json describes.

    Raises ReconFailure (bad-mat) that names `source`, the field, what was found and what was expected.
    """

    def bad(field: str, fault: str, expected: str) -> ReconFailure:
        return ReconProblem.BAD_MAT.failure(f"{source}: {field}: found {fault}; expected {expected}.")

    if not isinstance(mapping, Mapping):
        raise bad("the file", _short(mapping), 'an object with "dict" and "tags"')
    name = mapping.get("dict")
    if not isinstance(name, str) or not hasattr(cv2.aruco, f"DICT_{name}"):
        fault = _short(name) if "dict" in mapping else "nothing"
        raise bad("dict", fault, "the name of a marker dictionary, such as APRILTAG_36h11")
    tags = mapping.get("tags")
    if not isinstance(tags, Mapping) or len(tags) < 4:
        raise bad("tags", _short(tags) if "tags" in mapping else "nothing", "an object of at least four tags")
    known = _dictionary(name).bytesList.shape[0]
    corners: dict[int, Float[np.ndarray, "4 3"]] = {}
    for key, value in tags.items():
        if not (str(key).isdecimal() and str(key).isascii() and len(str(key)) < 8 and int(key) < known):
            raise bad("tags", f"the key {_short(key)}", f"numbers of tags, below {known}")
        points = _square(value, partial(bad, f"tags.{key}"))
        if int(key) in corners:
            raise bad(f"tags.{key}", "a tag that is given twice", "each tag once")
        corners[int(key)] = points
    if over := _overlapping(corners):
        fault = f"a tag that lies over tag {over[0]}"
        raise bad(f"tags.{over[1]}", fault, "each in a place of its own; write the mat with `drupe mat`")
    extent = 2 * np.abs(np.concatenate(list(corners.values()))).max(0)
    size = []
    for field, default in (("W", extent[0]), ("H", extent[1])):
        length = mapping.get(field, float(default))
        number = isinstance(length, int | float) and not isinstance(length, bool)
        if not (number and 0 < length <= 2 * FARTHEST_MM):
            raise bad(field, _short(length), "the mat's size in mm")
        size.append(float(length))
    return Mat(name, dict(sorted(corners.items())), size[0], size[1])


def _square(value: object, bad: Callable[[str, str], ReconFailure]) -> Float[np.ndarray, "4 3"]:
    """The four corners of one tag, mm; `bad` makes a failure of what was found and what was expected."""
    try:
        points = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        points = np.empty(0)
    if points.shape != (4, 3) or not np.isfinite(points).all():
        raise bad(_short(value), "four corners [x, y, z] in mm, top-left first, clockwise")
    if np.abs(points[:, 2]).max() > 1e-6:
        raise bad(_short(value), "corners on the plane z = 0")
    if np.abs(points).max() > FARTHEST_MM:
        raise bad(_short(value), f"corners within {FARTHEST_MM:g} mm of the mat's middle")
    sides = np.linalg.norm(np.roll(points, -1, 0) - points, axis=1)
    across = np.linalg.norm(points[:2] - points[2:], axis=1)
    side = float(sides.mean())
    if sides.min() <= 0 or np.ptp(sides) > 0.02 * side or np.ptp(across) > 0.02 * side:
        raise bad(_short(value), "the corners of a square, one after the other")
    if not TAG_MM[0] <= side <= TAG_MM[1]:
        slip = next((f": is it in {unit}?" for f, unit in _UNITS if TAG_MM[0] <= side * f <= TAG_MM[1]), "")
        raise bad(f"a tag {side:.3g} mm wide", f"{TAG_MM[0]:g} to {TAG_MM[1]:g} mm{slip}")
    if cv2.contourArea(points[:, :2].astype(np.float32), oriented=True) > 0:
        fault = "corners that run counter-clockwise"
        raise bad(fault, "top-left first, then clockwise, seen from above: does y point down?")
    return points


def _overlapping(corners: Mapping[int, Float[np.ndarray, "4 3"]]) -> tuple[int, int] | None:
    """The first two tags that overlap, by more than about a hundredth of a side; None without any."""
    squares = {tag: square[:, :2].astype(np.float32) for tag, square in corners.items()}
    middles = np.stack([square.mean(axis=0) for square in squares.values()])
    shrunk = [c + 0.99 * (square - c) for c, square in zip(middles, squares.values(), strict=True)]
    widest = max(np.linalg.norm(square[2] - square[0]) for square in shrunk)
    near = sorted(cKDTree(middles).query_pairs(float(widest)))
    pair = next((p for p in near if cv2.intersectConvexConvex(shrunk[p[0]], shrunk[p[1]])[0] > 0), None)
    return None if pair is None else (list(squares)[pair[0]], list(squares)[pair[1]])


def tag_bits(dictionary: str, tag: int) -> Bool[np.ndarray, "k k"]:
    """The printed cells of an upright tag, True where white, with its black border of one cell."""
    table = _dictionary(dictionary)
    cells = table.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(table, tag, cells, borderBits=1) > 127)


def detect_tags(
    image: Picture, mat: Mat, *, borders: tuple[int, ...] = BORDERS
) -> tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 4 2"]]:
    """The mat's tags in a photo: numbers and corners, px (centres are integers), to a fraction of a pixel.

    Corners are in the mat's order, because AprilTag's own images are rotated by 180 degrees against OpenCV's.
    `borders` are tried until the tags fit the mat. Tags that do not fit, and fewer than four, are returned as
    OpenCV reads them.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    as_read, placed = [], []
    for border in borders:
        tags, corners = _read(grey, mat, border)
        as_read.append((tags, corners))
        printed_mm = np.array([mat.corners_mm[t] for t in tags.tolist()]).reshape(-1, 4, 3)
        expected = _expected(corners, printed_mm)
        if expected is None:
            continue
        turned = np.stack([np.roll(corners, k, axis=1) for k in range(4)])
        side = np.maximum(np.linalg.norm(expected[:, 1] - expected[:, 0], axis=1), LEAST_SIDE_PX)
        off = np.median(np.linalg.norm(turned - expected, axis=3).max(axis=2) / side, axis=1)
        if off.min() > PLACED:
            continue
        inside = ((expected >= 0) & (expected <= np.array(grey.shape[::-1]) - 1)).all(axis=(1, 2))
        ordered = (tags, turned[off.argmin()])
        placed.append(ordered if border == 1 else (tags[inside], _refined(grey, expected[inside])))
        if off.min() < SHARP:
            break
    return max(reversed(placed), key=lambda detection: len(detection[0]), default=as_read[0])


def _read(
    grey: UInt8[np.ndarray, "h w"], mat: Mat, border: int
) -> tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 4 2"]]:
    """Tags of the mat that OpenCV reads exactly once with a border of `border` cells, by number."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 4
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = 7, 35
    parameters.adaptiveThreshWinSizeStep = 14
    detector = cv2.aruco.ArucoDetector(_dictionary(mat.dictionary), parameters)
    outlines, numbers, _ = detector.detectMarkers(grey)
    if numbers is None or len(numbers) == 0:
        return np.empty(0, int), np.empty((0, 4, 2))
    tags = np.asarray(numbers, int).ravel()
    corners = np.asarray(outlines, float).reshape(-1, 4, 2)
    once = np.array([tag in mat.corners_mm and (tags == tag).sum() == 1 for tag in tags.tolist()])
    order = np.argsort(tags[once])
    return tags[once][order], corners[once][order]


def _expected(
    corners: Float[np.ndarray, "t 4 2"], printed_mm: Float[np.ndarray, "t 4 3"]
) -> Float[np.ndarray, "t 4 2"] | None:
    """Expected corners, px, from the mat and the tags' middles; None for fewer than four tags or a line.

    The homography of the middles gives shape and rotation of each tag, and its own middle the place. So the
    lens's distortion counts only within a tag.
    """
    if len(corners) < 4:
        return None
    middles, flat_mm = _crossing(corners)[:, None], printed_mm[:, :, :2]
    middles_mm = flat_mm.mean(axis=1, keepdims=True)
    H = cv2.findHomography(middles_mm, middles, cv2.LMEDS)[0]
    if H is None:
        return None
    away = middles - cv2.perspectiveTransform(middles_mm, H)
    return np.asarray(cv2.perspectiveTransform(flat_mm, H) + away)


def _crossing(corners: Float[np.ndarray, "t 4 2"]) -> Float[np.ndarray, "t 2"]:
    """Intersection of each tag's diagonals: the image of its middle."""
    start, along, other = corners[:, 0], corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    between = corners[:, 1] - start
    share = (between[:, 0] * other[:, 1] - between[:, 1] * other[:, 0]) / (
        along[:, 0] * other[:, 1] - along[:, 1] * other[:, 0]
    )
    return np.asarray(start + share[:, None] * along)


def _refined(
    grey: UInt8[np.ndarray, "h w"], corners: Float[np.ndarray, "t 4 2"]
) -> Float[np.ndarray, "t 4 2"]:
    """Corners to a fraction of a pixel; Kalibr's tags touch squares there, which shorten the found outline.

    The window reaches 0.08 of a side: the border is 0.2 wide.
    """
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
    points = corners.reshape(-1, 1, 2).astype(np.float32)
    side = np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    reach = (max(4, round(0.08 * float(side))),) * 2
    return np.asarray(cv2.cornerSubPix(grey, points, reach, (-1, -1), stop), float).reshape(-1, 4, 2)


def _dictionary(name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def _short(value: object) -> str:
    """A value as in the file, cut to 60 characters."""
    text = json.dumps(value, default=repr)
    return text if len(text) <= 60 else f"{text[:57]}..."
