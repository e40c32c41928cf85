"""The printed marker mat: where each tag's corners lie, how to read mat.json, how to see the tags in a
photo.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from recon.failure import ReconFailure, ReconProblem

TAG_MM, FARTHEST_MM = (3.0, 300.0), 2000.0
"""Sides of tags from a 30 mm mat's to a poster's, and how far from the middle one lies: `drupe mat` prints 9
and 18 mm within 95 mm."""
_UNITS = ((10.0, "cm"), (25.4, "inches"), (1000.0, "m"))


@dataclass(frozen=True)
class Mat:
    """Tags on a plane, mm, z up: `corners_mm[id]` is (4, 3), top-left first, clockwise; the centre is
    blank.
    """

    dictionary: str
    corners_mm: dict[int, Float[np.ndarray, "4 3"]]
    width_mm: float
    height_mm: float

    @property
    def tag_mm(self) -> float:
        """Side of the first tag."""
        corners = next(iter(self.corners_mm.values()))
        return float(np.linalg.norm(corners[1] - corners[0]))


def standard_mat(
    *,
    columns: int = 7,
    rows: int = 7,
    blank: int = 3,
    tag_mm: float = 18.0,
    gap_mm: float = 5.0,
    margin_mm: float = 17.0,
) -> Mat:
    """A square mat with `blank` x `blank` places left free in the middle for the fruit.

    The default, 40 tags on 190 x 190 mm, fits A4 and Letter paper. Halve `tag_mm` and `gap_mm` for cherries.
    """
    pitch = tag_mm + gap_mm
    corners: dict[int, Float[np.ndarray, "4 3"]] = {}
    for row in range(rows):
        for column in range(columns):
            if 2 * abs(row - (rows - 1) / 2) < blank and 2 * abs(column - (columns - 1) / 2) < blank:
                continue
            x, y = (column - (columns - 1) / 2) * pitch, ((rows - 1) / 2 - row) * pitch
            h = tag_mm / 2
            corners[len(corners)] = np.array(
                [(x - h, y + h, 0), (x + h, y + h, 0), (x + h, y - h, 0), (x - h, y - h, 0)]
            )
    width, height = (n * pitch - gap_mm + 2 * margin_mm for n in (columns, rows))
    return Mat("APRILTAG_36h11", corners, width, height)


def mat_mapping(mat: Mat) -> dict[str, Any]:
    """What mat.json holds for a mat; `parse_mat` takes it back."""
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

    def bad(field: str, found: object, expected: str) -> ReconFailure:
        return ReconFailure(
            ReconProblem.BAD_MAT, f"{source}: {field} is {_short(found)}; expected {expected}."
        )

    if not isinstance(mapping, Mapping):
        raise bad("the file", mapping, 'an object with "dict" and "tags"')
    name = mapping.get("dict", "missing")
    if not isinstance(name, str) or not hasattr(cv2.aruco, f"DICT_{name}"):
        raise bad('"dict"', name, "the name of a marker dictionary, such as APRILTAG_36h11")
    tags = mapping.get("tags", "missing")
    if not isinstance(tags, Mapping) or len(tags) < 4:
        raise bad('"tags"', tags, "an object of at least four tags")
    known = _dictionary(name).bytesList.shape[0]
    corners: dict[int, Float[np.ndarray, "4 3"]] = {}
    for key, value in tags.items():
        if not (str(key).isdecimal() and len(str(key)) < 8 and int(key) < known):
            raise bad(f'"tags", key {_short(key)},', key, f"a tag number below {known}")
        try:
            points = np.asarray(value, float)
        except (TypeError, ValueError, OverflowError):
            points = np.empty(0)
        if points.shape != (4, 3) or not np.isfinite(points).all():
            raise bad(f'"tags"."{key}"', value, "four corners [x, y, z] in mm, top-left first, clockwise")
        if np.abs(points[:, 2]).max() > 1e-6:
            raise bad(f'"tags"."{key}"', value, "corners on the plane z = 0")
        if np.abs(points).max() > FARTHEST_MM:
            raise bad(f'"tags"."{key}"', value, f"corners within {FARTHEST_MM:g} mm of the mat's middle")
        sides = np.linalg.norm(np.roll(points, -1, 0) - points, axis=1)
        if sides.min() <= 0 or np.ptp(sides) > 0.02 * sides.mean():
            raise bad(f'"tags"."{key}"', value, "a square")
        side = float(sides.mean())
        if not TAG_MM[0] <= side <= TAG_MM[1]:
            slip = next(
                (f": is it in {unit}?" for f, unit in _UNITS if TAG_MM[0] <= side * f <= TAG_MM[1]), ""
            )
            found = f"a tag {side:.3g} mm wide"
            raise bad(f'"tags"."{key}"', found, f"{TAG_MM[0]:g} to {TAG_MM[1]:g} mm{slip}")
        corners[int(key)] = points
    extent = 2 * np.abs(np.concatenate(list(corners.values()))).max(0)
    size = []
    for field, default in (("W", extent[0]), ("H", extent[1])):
        length = mapping.get(field, float(default))
        number = isinstance(length, int | float) and not isinstance(length, bool)
        if not (number and 0 < length <= 2 * FARTHEST_MM):
            raise bad(f'"{field}"', length, "the mat's size in mm")
        size.append(float(length))
    return Mat(name, dict(sorted(corners.items())), size[0], size[1])


def tag_bits(dictionary: str, tag: int) -> Bool[np.ndarray, "k k"]:
    """The printed cells of a tag, True where white, its black border (one cell) included, as seen upright."""
    table = _dictionary(dictionary)
    cells = table.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(table, tag, cells, borderBits=1) > 127)


def detect_tags(
    image: UInt8[np.ndarray, "h w 3"], mat: Mat
) -> tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 4 2"]]:
    """The mat's tags in a photo: their numbers and corners, px (pixel centres whole), to a fraction of a
    pixel.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 4
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = 7, 35
    parameters.adaptiveThreshWinSizeStep = 14
    detector = cv2.aruco.ArucoDetector(_dictionary(mat.dictionary), parameters)
    found, numbers, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    if numbers is None or len(numbers) == 0:
        return np.empty(0, int), np.empty((0, 4, 2))
    tags = np.asarray(numbers, int).ravel()
    corners = np.asarray(found, float).reshape(-1, 4, 2)
    once = np.array([tag in mat.corners_mm and (tags == tag).sum() == 1 for tag in tags.tolist()])
    order = np.argsort(tags[once])
    return tags[once][order], corners[once][order]


def _dictionary(name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
