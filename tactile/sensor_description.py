"""From what is published of a sensor, and a picture of its untouched gel, to its description."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import UInt8

from tactile.camera_from_dots import CameraFound, camera_from_dots
from tactile.gel.gel_sides import GelOutline
from tactile.io.sensor_model import Published, SensorModel
from tactile.tactile_failure import TactileFailure, TactileProblem

NEEDED = ("thickness_mm", "E_MPa", "nu")
"""Of a gel, without which no force follows."""
OF_DEPTH = 0.45
"""Relative error of the force per relative error of the camera's distance, root mean square: a quarter less
of it changed forces of dots alone by 15 %, a quarter more by 5 % (benchmarks/gel_image_errors.py --distance
0.75 and 1.25)."""
OPTIONS = {"thickness_mm": "--thickness-mm", "E_MPa": "--E-MPa", "nu": "--nu", "pitch_mm": "--pitch-mm"}
"""What gives each on the command line."""


@dataclass(frozen=True, kw_only=True)
class Described:
    """`table`: the description, as a TOML file holds it; `said`: what is known how well, a line each."""

    table: dict[str, Any]
    said: tuple[str, ...]


def outline_of(model: SensorModel) -> GelOutline | None:
    """The gel's sides and dome, where its size is published."""
    size, dome = model.gel.get("size_mm"), model.gel.get("face_radius_mm")
    if size is None:
        return None
    return GelOutline(
        size_mm=_two(size),
        face_radius_mm=(np.inf, np.inf) if dome is None else _two(dome),
    )


def described(model: SensorModel, picture: UInt8[np.ndarray, "h w 3"] | None, *, source: str) -> Described:
    """The description of one sensor of that kind, whose camera a picture of its untouched gel gives.

    Raises TactileFailure: unreadable-sensor for what is neither published nor given, and what
    camera_from_dots raises of the picture.
    """
    if model.kind == "fields":
        spread = {name: one.relative_sd for name, one in model.fields.items()}
        table = {"kind": model.kind, "name": model.name, "spread": spread}
        return Described(table=table, said=_said(model, {}, spread))
    missing = [OPTIONS[name] for name in NEEDED if name not in model.gel]
    missing += ["--pitch-mm"] if model.pitch_mm is None else []
    if missing or model.distance_mm is None or model.pitch_mm is None:
        raise TactileFailure(
            TactileProblem.UNREADABLE_SENSOR,
            f"{model.name}: no published values exist for {', '.join(missing)}; measure them and give them.",
        )
    if picture is None:
        raise TactileFailure(
            TactileProblem.UNREADABLE_SENSOR,
            f"{model.name}: found no picture of the untouched gel, expected one at the size of the "
            "recordings' frames; give --picture.",
        )
    grid = None if model.rows is None or model.columns is None else (model.rows, model.columns)
    found = camera_from_dots(
        picture,
        pitch_mm=_two(model.pitch_mm),
        distance_mm=float(model.distance_mm.value[0]),
        outline=outline_of(model),
        source=source,
        grid=grid,
    )
    ratio, ratio_sd = found.aspect or (1.0, 0.0)
    spread = _spread(model, model.pitch_mm, model.distance_mm, ratio_sd=ratio_sd / ratio)
    table = {
        "kind": model.kind,
        "name": model.name,
        "gel": {name: _plain(one) for name, one in model.gel.items()},
        "camera": _camera(found),
        "markers": {"rows": found.rows, "columns": found.columns, "pitch_mm": list(_two(model.pitch_mm))},
        "spread": spread,
    }
    seen = [
        f"{source}: {found.dots} dots of a grid of {found.rows} x {found.columns}, {found.off_px:.2g} "
        "px off the grid of the fitted camera"
    ]
    if found.aspect is not None:
        seen.append(
            f"{source}: the picture was resized without its proportions. A millimetre along x has "
            f"{ratio:.3f} ± {ratio_sd:.3f} times the pixels of a millimetre along y. drupe reads frames "
            "of this size as they are. The ratio takes both pitches as exact: if nobody resized the "
            "frames, correct --pitch-mm"
        )
    return Described(table=table, said=(*seen, *_said(model, _forces(model), spread)))


def with_given(model: SensorModel, given: dict[str, tuple[tuple[float, ...], float]]) -> SensorModel:
    """The model with what the user measured (value, relative spread) in place of what is published."""
    own = {
        name: Published(
            value=np.array(value), sd=share * float(np.mean(np.abs(value))), source="given by the user"
        )
        for name, (value, share) in given.items()
    }
    pitch = own.pop("pitch_mm", model.pitch_mm)
    distance = own.pop("distance_mm", model.distance_mm)
    return replace(model, gel=model.gel | own, pitch_mm=pitch, distance_mm=distance)


def _forces(model: SensorModel) -> dict[str, float]:
    """Relative spread of the force by its causes in the gel: modulus, thickness, Poisson's ratio.

    Under a contact about as wide as the gel is thick the force goes with E, with the thickness to the power
    -1 at most (a bonded layer's goes with -1, a half-space's with 0), and with nu as a half-space's 1/(1 -
    nu^2).
    """
    nu = model.gel["nu"]
    value = float(nu.value[0])
    return {
        "E_MPa": model.gel["E_MPa"].relative_sd,
        "thickness_mm": model.gel["thickness_mm"].relative_sd,
        "nu": 2 * value * nu.sd / (1 - value**2),
    }


def _spread(
    model: SensorModel, pitch: Published, distance: Published, *, ratio_sd: float
) -> dict[str, float]:
    """Relative standard deviations of force and displacement, which all markers and frames share.

    A force is taken from displacements, so it has their scale's error as well. `ratio_sd`: of the focal
    lengths' ratio in a resized picture.
    """
    depth = OF_DEPTH * distance.relative_sd
    scale = float(np.hypot(pitch.relative_sd, ratio_sd))
    force = float(np.linalg.norm([*_forces(model).values(), scale, depth]))
    return {"force": round(force, 4), "displacement": round(scale, 4)}


def _said(model: SensorModel, causes: dict[str, float], spread: dict[str, float]) -> tuple[str, ...]:
    """What each value rests on, and what comes of it."""
    known = {**model.gel, "pitch_mm": model.pitch_mm, "distance_mm": model.distance_mm, **model.fields}
    lines = [
        f"{name} {_words(one)} ({one.source})"
        + (f": ± {causes[name]:.0%} of force" if name in causes else "")
        for name, one in known.items()
        if one is not None
    ]
    lines.append(
        f"force ± {spread['force']:.0%} and displacement ± {spread['displacement']:.1%}, common to "
        "all grasps of this sensor. E has at least this error, but the order of fruit graded with "
        "this sensor does not"
    )
    return (*lines, *([model.notes] if model.notes else []))


def _words(one: Published) -> str:
    return f"{' x '.join(f'{value:g}' for value in one.value)} ± {one.sd:g}"


def _camera(found: CameraFound) -> dict[str, Any]:
    camera = found.camera
    return {
        "image_px": list(camera.image_px),
        "focal_px": list(camera.focal_px),
        "centre_px": list(camera.centre_px),
        "distortion": list(camera.distortion),
        "gel_from_camera": camera.gel_from_camera.tolist(),
    }


def _plain(one: Published) -> float | list[float]:
    return float(one.value[0]) if len(one.value) == 1 else one.value.tolist()


def _two(one: Published) -> tuple[float, float]:
    return float(one.value[0]), float(one.value[-1])
