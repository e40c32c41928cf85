"""A tactile sensor: its camera, its gel and its markers.

It has two frames. The gel frame is the pad frame of a recording: origin at the centre of the undeformed gel
face, z out of the gel into the fruit. The camera frame is OpenCV's: x right, y down, z forward, pixel (0, 0)
the centre of the first pixel. A camera behind the gel that looks out through it without rotation has
`gel_from_camera` = identity with a shift along negative z.
"""

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from tactile.gel.gel_sides import GelOutline
from tactile.tactile_failure import TactileProblem

SensorKind: TypeAlias = Literal["markers-mono", "markers-stereo", "fields"]


@dataclass(frozen=True, kw_only=True)
class GelCamera:
    """A pinhole camera with OpenCV's lens distortion, and its pose.

    `image_px` and every pair is (x, y), so width first. `distortion` is (k1, k2, p1, p2, k3).
    `gel_from_camera` takes camera coordinates to gel coordinates, lengths in mm.
    """

    image_px: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    gel_from_camera: Float[np.ndarray, "4 4"]

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The intrinsics as OpenCV takes them, px."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def camera_from_gel(self) -> Float[np.ndarray, "4 4"]:
        """The inverse of `gel_from_camera`."""
        inverse: Float[np.ndarray, "4 4"] = np.linalg.inv(self.gel_from_camera)
        return inverse


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """One sensor; what a kind does not need is None or empty.

    `markers-mono` has a `camera`, `markers-stereo` also a `second_camera`, and both the gel's `thickness_mm`,
    `E_MPa` and `nu` (bonded to its back), and its `outline` where that is known. `fields` is a sensor that
    gives displacement and force itself. `rest_mm` are the markers on the undeformed gel, gel frame; without
    them a marker's place is where its ray meets the plane z = 0. `gel_kn_MPa_per_mm` and `gel_kt_MPa_per_mm`,
    the layer's normal and shear stiffness per area, are stated where they were measured. `force_sd` and
    `displacement_sd`: relative standard deviations of both scales, which all its recordings share.
    """

    kind: SensorKind
    name: str
    serial: str = ""
    camera: GelCamera | None = None
    second_camera: GelCamera | None = None
    thickness_mm: float | None = None
    E_MPa: float | None = None
    nu: float | None = None
    outline: GelOutline | None = None
    gel_kn_MPa_per_mm: float | None = None
    gel_kt_MPa_per_mm: float | None = None
    rest_mm: Float[np.ndarray, "n 3"] | None = None
    force_sd: float = 0.0
    displacement_sd: float = 0.0


def marker_grid(
    rows: int, columns: int, *, pitch_mm: tuple[float, float], first_mm: tuple[float, float, float] | None
) -> Float[np.ndarray, "n 3"]:
    """A grid of markers, row by row: columns run along x, rows along y, `pitch_mm` is (x, y).

    `first_mm` is the marker of row 0 and column 0; None centres the grid on the gel.

    >>> marker_grid(1, 2, pitch_mm=(2.0, 2.0), first_mm=None).tolist()
    [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    x, y = np.meshgrid(np.arange(columns) * pitch_mm[0], np.arange(rows) * pitch_mm[1])
    grid = np.stack([x.ravel(), y.ravel(), np.zeros(rows * columns)], axis=1)
    start = np.array([-x[0, -1] / 2, -y[-1, 0] / 2, 0.0]) if first_mm is None else np.asarray(first_mm)
    return np.asarray(grid + start)


def bonded_stiffness(E_MPa: float, nu: float, thickness_mm: float) -> tuple[float, float]:
    """Normal and shear stiffness per area (MPa/mm) of a bonded layer under wide contact.

    kn = E (1 - nu) / ((1 + nu) (1 - 2 nu) h) and kt = E / (2 (1 + nu) h).
    """
    kn = E_MPa * (1 - nu) / ((1 + nu) * (1 - 2 * nu) * thickness_mm)
    return kn, E_MPa / (2 * (1 + nu) * thickness_mm)


def gel_constants(sensor: Sensor) -> dict[str, Any]:
    """The sensor's constants of gel and scales, by the fields of a recording's gel pad.

    The stiffness per area (MPa/mm) is the measured one, or that of a bonded layer. Raises TactileFailure
    (unreadable-sensor) if the description has neither.
    """
    E, nu, h = sensor.E_MPa, sensor.nu, sensor.thickness_mm
    kn, kt = sensor.gel_kn_MPa_per_mm, sensor.gel_kt_MPa_per_mm
    if E is not None and nu is not None and h is not None:
        bonded_kn, bonded_kt = bonded_stiffness(E, nu, h)
        kn, kt = kn or bonded_kn, kt or bonded_kt
    if kn is None or kt is None:
        raise TactileProblem.UNREADABLE_SENSOR.failure(
            f"{sensor.name}: found neither the gel's stiffness nor thickness_mm, E_MPa and nu, "
            "expected one of the two; add gel_kn_MPa_per_mm and gel_kt_MPa_per_mm to [gel].",
        )
    return {
        "gel_kn_MPa_per_mm": kn,
        "gel_kt_MPa_per_mm": kt,
        "thickness_mm": h,
        "gel_E_MPa": E,
        "gel_nu": nu,
        "force_scale_sd": sensor.force_sd,
        "displacement_scale_sd": sensor.displacement_sd,
    }
