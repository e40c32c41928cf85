"""A sensor's description in TOML, one file per sensor (docs/formats.md, "A sensor's description")."""

from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float

from tactile.gel.gel_sides import SIDES, GelOutline, GelSides
from tactile.readers.recording import MODULUS, RATIO, SCALE_SD, STIFFNESS, THICKNESS
from tactile.readers.toml_table import Table, read_table
from tactile.sensors import GelCamera, Sensor, SensorKind, marker_grid
from tactile.tactile_failure import TactileProblem

KINDS = ("markers-mono", "markers-stereo", "fields")
TOP = {"kind", "name", "serial", "gel", "camera", "second_camera", "markers", "calibrated_on", "spread"}
GEL = {
    "thickness_mm", "E_MPa", "nu", "size_mm", "centre_mm", "sides", "face_radius_mm", "gel_kn_MPa_per_mm",
    "gel_kt_MPa_per_mm",
}  # fmt: skip
SIZE_MM = (1.0, 1000.0)
"""Least and largest side of a gel's face."""
MOST_SAG = 0.6
"""Largest depth of a domed face's corners below its middle, over the thickness. Set by hand: GelSight Mini's
have a third."""
LEAST_PITCH_MM = 0.01
"""Least distance of markers that a camera in a gel can separate."""


def read_sensor(path: Path) -> Sensor:
    """The sensor that `path` describes.

    Raises TactileFailure (unreadable-sensor) that names the file, the field, what was found and what was
    expected. Causes are a missing file, text that is not TOML, unknown keys and wrong values. The file may
    also lack a key or table that the sensor's kind needs.
    """
    top = read_table(path, TactileProblem.UNREADABLE_SENSOR, what="a sensor's description")
    top.refuse_unknown(TOP)
    top.day("calibrated_on")
    kind = top.choice("kind", KINDS)
    stereo, images = kind == "markers-stereo", kind != "fields"
    gel = top.table("gel", needed=images)
    gel.refuse_unknown(GEL)
    outline = _outline(gel)
    return Sensor(
        kind=cast(SensorKind, kind),
        name=top.text("name"),
        serial=top.text("serial", default=""),
        camera=_camera(top.table("camera", needed=images)),
        second_camera=_camera(top.table("second_camera", needed=stereo)),
        thickness_mm=gel.within("thickness_mm", THICKNESS, needed=images),
        E_MPa=gel.within("E_MPa", MODULUS, needed=images),
        nu=gel.within("nu", RATIO, needed=images),
        outline=outline,
        gel_kn_MPa_per_mm=gel.within("gel_kn_MPa_per_mm", STIFFNESS, needed=False),
        gel_kt_MPa_per_mm=gel.within("gel_kt_MPa_per_mm", STIFFNESS, needed=False),
        rest_mm=_rest(top.table("markers", needed=False), outline),
        force_sd=_spread(top, "force"),
        displacement_sd=_spread(top, "displacement"),
    )


def _spread(top: Table, name: str) -> float:
    """A relative standard deviation in [spread]; 0 if it is missing."""
    table = top.table("spread", needed=False)
    table.refuse_unknown({"force", "displacement"})
    return table.within(name, SCALE_SD, needed=False) or 0.0


def _outline(gel: Table) -> GelOutline | None:
    """The gel's size, middle and sides; None without its size. Raises TactileFailure."""
    size = gel.numbers("size_mm", (2,), needed=False)
    if size is None:
        for name in ("centre_mm", "sides", "face_radius_mm"):
            if name in gel.values:
                raise gel.refusal("size_mm", "none", f"the gel's size along x and y, mm, beside {name}")
        return None
    if not ((size >= SIZE_MM[0]) & (size <= SIZE_MM[1])).all():
        raise gel.refusal(
            "size_mm", str(size.tolist()), f"two lengths of {SIZE_MM[0]:g} to {SIZE_MM[1]:g} mm"
        )
    centre = gel.numbers("centre_mm", (2,), needed=False)
    sides = gel.choice("sides", SIDES) if "sides" in gel.values else SIDES[0]
    radius = gel.numbers("face_radius_mm", (2,), needed=False)
    if radius is not None and not (radius >= size / 2).all():
        expected = "two radii, mm, along x and y, each at least half of the gel's size"
        raise gel.refusal("face_radius_mm", str(radius.tolist()), expected)
    outline = GelOutline(
        size_mm=_two(size),
        centre_mm=(0.0, 0.0) if centre is None else _two(centre),
        sides=cast(GelSides, sides),
        face_radius_mm=(np.inf, np.inf) if radius is None else _two(radius),
    )
    thickness = gel.within("thickness_mm", THICKNESS, needed=False)
    if thickness is not None and outline.lowest_mm > MOST_SAG * thickness:
        fault = (
            f"{radius} of a gel {thickness:g} mm thick, whose corners lie {outline.lowest_mm:.3g} mm lower"
        )
        raise gel.refusal("face_radius_mm", fault, f"corners at most {MOST_SAG:.0%} of the thickness lower")
    return outline


def _camera(table: Table) -> GelCamera | None:
    """The camera of a sensor's description; None without one. Raises TactileFailure."""
    if not table:
        return None
    table.refuse_unknown({"image_px", "focal_px", "centre_px", "distortion", "gel_from_camera"})
    width, height = table.numbers("image_px", (2,)).tolist()
    if not (width >= 1 and height >= 1 and width % 1 == 0 and height % 1 == 0):
        raise table.refusal("image_px", f"[{width:g}, {height:g}]", "width and height in whole pixels")
    focal = table.numbers("focal_px", (2,))
    if not (focal >= 1).all():
        raise table.refusal("focal_px", str(focal.tolist()), "two numbers of pixels, 1 or more")
    distortion = table.numbers("distortion", (5,), needed=False)
    return GelCamera(
        image_px=(int(width), int(height)),
        focal_px=(float(focal[0]), float(focal[1])),
        centre_px=_two(table.numbers("centre_px", (2,))),
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0) if distortion is None else tuple(distortion.tolist()),
        gel_from_camera=table.pose("gel_from_camera"),
    )


def _rest(table: Table, outline: GelOutline | None) -> Float[np.ndarray, "n 3"] | None:
    """The markers' rest positions (mm), as listed or as a grid; None if the description has neither. A grid
    follows a domed face.
    """
    if not table:
        return None
    if "rest_mm" in table.values:
        table.refuse_unknown({"rest_mm"})
        rest: Float[np.ndarray, "n 3"] = table.numbers("rest_mm", (None, 3))
        return rest
    table.refuse_unknown({"rows", "columns", "pitch_mm", "first_mm"})
    pitch = table.numbers("pitch_mm", (2,))
    if not (pitch >= LEAST_PITCH_MM).all():
        expected = f"two distances in mm, {LEAST_PITCH_MM:g} or more"
        raise table.refusal("pitch_mm", str(pitch.tolist()), expected)
    first = table.numbers("first_mm", (3,), needed=False)
    grid = marker_grid(
        table.whole("rows"),
        table.whole("columns"),
        pitch_mm=_two(pitch),
        first_mm=None if first is None else (float(first[0]), float(first[1]), float(first[2])),
    )
    if outline is not None:
        grid[:, 2] += outline.face_mm(grid[:, 0], grid[:, 1])
    return grid


def _two(pair: Float[np.ndarray, "2"]) -> tuple[float, float]:
    return float(pair[0]), float(pair[1])
