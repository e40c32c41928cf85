"""From published values of a sensor, and a picture of its untouched gel, to its description.

The picture's dots are the scale: they lie on a grid of known pitch on the gel's face. With the distance
given, one picture determines the focal length, the first radial distortion, the camera's rotation and the
point that it faces. These are seven numbers, from a pair for each dot. One picture of a face cannot determine
the distance itself, which scales with the focal length.

A camera's pixels are square. If no such camera fits the dots, the picture may have been resized without its
proportions: the ratio of the focal lengths along x and y is then the eighth number. Distortion is a function
of directions, not of pixels, so resizing does not change it.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.optimize import OptimizeResult, least_squares

from tactile.gel.gel_sides import GelOutline
from tactile.gel_camera import has_square_pixels, project
from tactile.markers.smooth_lattice import FEWEST, lattice_places
from tactile.markers.tracking import reference_of
from tactile.readers.sensor_model import Published, SensorModel
from tactile.sensors import GelCamera
from tactile.tactile_failure import TactileFailure, TactileProblem

OFF_GRID = 0.06
"""Share of the pitch: greatest root mean square by which dots may be off the grid of the fitted camera. Empty
gels have 0.021 to 0.048 of it (135 first frames), printed dots as such; loaded ones reach 0.14."""

SQUARE = 7
"""Parameters of a camera with square pixels; the next is the logarithm of the ratio of its focal lengths."""
NEEDED = ("thickness_mm", "E_MPa", "nu")
"""Values of a gel without which no force can be computed."""
OF_DEPTH = 0.45
"""Relative error of the force per relative error of the camera's distance, root mean square. A quarter less
distance changed forces from dots alone by 15 %, a quarter more by 5 % (benchmarks/gel_image_errors.py
--distance 0.75 and 1.25)."""
OPTIONS = {"thickness_mm": "--thickness-mm", "E_MPa": "--E-MPa", "nu": "--nu", "pitch_mm": "--pitch-mm"}
"""The command-line option of each."""


@dataclass(frozen=True, kw_only=True)
class CameraFound:
    """`rows` and `columns` of the grid, number of its `dots` found, and their deviation `off_px` (root mean
    square). `aspect`: of a resized picture, focal length along x over that along y and its standard deviation
    (of the fit; both pitches assumed exact); None: the pixels are square.
    """

    camera: GelCamera
    rows: int
    columns: int
    dots: int
    off_px: float
    aspect: tuple[float, float] | None = None


def camera_from_dots(
    picture: UInt8[np.ndarray, "h w 3"],
    *,
    pitch_mm: tuple[float, float],
    distance_mm: float,
    outline: GelOutline | None,
    source: str,
    grid: tuple[int, int] | None = None,
) -> CameraFound:
    """The camera that sees the grid's dots where they are; the grid's middle is the gel frame's origin.

    `grid`: rows and columns on the gel. A cropped picture may show a part of them; its middle then faces the
    gel's, to half a pitch. Without `grid` the visible dots are all. Raises TactileFailure: no-markers, or
    wrong-sensor if the dots are no grid, more than that, or off it by more than OFF_GRID of the pitch.
    """
    reference = reference_of(picture, source=source)
    places, known = lattice_places(reference.lattice)
    seen, places = reference.lattice.rest_px[known], places[known]
    if len(places) < FEWEST:
        raise _refused(source, f"{len(places)} dots on a grid", f"at least {FEWEST}")
    height, width = picture.shape[:2]
    seen_rows, seen_columns = (int(v) for v in np.round(np.ptp(places, axis=0))[::-1] + 1)
    rows, columns = grid or (seen_rows, seen_columns)
    if seen_rows > rows or seen_columns > columns:
        raise _refused(source, f"a grid of {seen_rows} x {seen_columns} dots", f"{rows} x {columns} at most")
    hidden = columns - seen_columns, rows - seen_rows
    middle = _middle_of_grid(places, seen, hidden=hidden, shape=(height, width))
    on_face = np.column_stack([(places - middle) * pitch_mm, np.zeros(len(places))])
    if outline is not None:
        on_face[:, 2] = outline.face_mm(on_face[:, 0], on_face[:, 1])

    def camera_of(values: Float[np.ndarray, " p"]) -> GelCamera:
        turn = cv2.Rodrigues(np.asarray(values[2:5]))[0]
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = [values[5], values[6], -distance_mm]
        focal, aspect = np.exp(values[0]), np.exp(values[7]) if len(values) > SQUARE else 1.0
        return GelCamera(
            image_px=(width, height),
            focal_px=(float(focal * np.sqrt(aspect)), float(focal / np.sqrt(aspect))),
            centre_px=((width - 1) / 2, (height - 1) / 2),
            distortion=(float(values[1]), 0.0, 0.0, 0.0, 0.0),
            gel_from_camera=pose,
        )

    def misfit(values: Float[np.ndarray, " p"]) -> Float[np.ndarray, " m"]:
        return np.asarray((project(camera_of(values), on_face) - seen).ravel())

    spacing = reference.lattice.spacing_px
    start = np.array([np.log(spacing / np.mean(pitch_mm) * distance_mm), 0, 0, 0, 0, 0, 0, 0], dtype=float)
    unit = np.array([0.1, 0.1, 0.1, 0.1, 0.1, *(0.5 * np.asarray(pitch_mm)), 0.1])
    for count in (SQUARE, SQUARE + 1):
        fit = least_squares(
            misfit, start[:count], loss="soft_l1", f_scale=0.02 * spacing, x_scale=unit[:count]
        )
        off = float(np.sqrt(np.mean(np.sum(misfit(fit.x).reshape(-1, 2) ** 2, axis=1))))
        camera = camera_of(fit.x)
        if off <= OFF_GRID * spacing and (count == SQUARE or not has_square_pixels(camera)):
            break
    else:
        raise _refused(
            source,
            f"dots that deviate by {off:.3g} px from a grid of {pitch_mm[0]:g} x {pitch_mm[1]:g} mm "
            "behind any camera",
            f"at most {OFF_GRID * spacing:.3g} px; check that the gel is untouched and the pitch is right",
        )
    return CameraFound(
        camera=camera,
        rows=rows,
        columns=columns,
        dots=len(places),
        off_px=off,
        aspect=None if count == SQUARE else _aspect(camera, fit),
    )


def _aspect(camera: GelCamera, fit: OptimizeResult) -> tuple[float, float]:
    """Ratio of the focal lengths, and its standard deviation from the dots' residuals."""
    freedom = len(fit.fun) - len(fit.x)
    variance = np.linalg.inv(fit.jac.T @ fit.jac)[-1, -1] * float(fit.fun @ fit.fun) / freedom
    ratio = camera.focal_px[0] / camera.focal_px[1]
    return ratio, float(ratio * np.sqrt(variance))


def _middle_of_grid(
    places: Float[np.ndarray, "n 2"],
    seen_px: Float[np.ndarray, "n 2"],
    *,
    hidden: tuple[int, int],
    shape: tuple[int, int],
) -> Float[np.ndarray, "2"]:
    """The whole grid's middle, in steps: of those that hidden columns and rows allow, the nearest to the
    picture's.
    """
    plain = np.column_stack([places, np.ones(len(places))])
    affine = np.linalg.lstsq(plain, seen_px, rcond=None)[0]
    looked_at = np.linalg.solve(affine[:2].T, (np.array(shape[::-1]) - 1) / 2 - affine[2])
    between = (places.min(axis=0) + places.max(axis=0)) / 2
    middle = []
    for k, count in enumerate(hidden):
        allowed = between[k] + np.arange(-count, count + 1, 2) / 2
        middle.append(allowed[np.abs(allowed - looked_at[k]).argmin()])
    return np.array(middle)


def _refused(source: str, fault: str, expected: str) -> TactileFailure:
    return TactileProblem.WRONG_SENSOR.failure(f"{source}: found {fault}, expected {expected}.")


@dataclass(frozen=True, kw_only=True)
class Described:
    """`table`: the description, as a TOML file holds it; `said`: the source and error of each value, a line
    each."""

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
    """The description of one sensor of that kind; a picture of its untouched gel gives its camera.

    Raises TactileFailure: unreadable-sensor for values that are neither published nor given, and as
    camera_from_dots does.
    """
    if model.kind == "fields":
        spread = {name: published.relative_sd for name, published in model.fields.items()}
        table = {"kind": model.kind, "name": model.name, "spread": spread}
        return Described(table=table, said=_said(model, {}, spread))
    missing = [OPTIONS[name] for name in NEEDED if name not in model.gel]
    missing += ["--pitch-mm"] if model.pitch_mm is None else []
    if missing or model.distance_mm is None or model.pitch_mm is None:
        raise TactileProblem.UNREADABLE_SENSOR.failure(
            f"{model.name}: no published values exist for {', '.join(missing)}; measure them and give them.",
        )
    if picture is None:
        raise TactileProblem.UNREADABLE_SENSOR.failure(
            f"{model.name}: found no picture of the untouched gel, expected one at the size of the "
            "recordings' frames; give --picture.",
        )
    grid = None if model.rows is None or model.columns is None else (model.rows, model.columns)
    fit = camera_from_dots(
        picture,
        pitch_mm=_two(model.pitch_mm),
        distance_mm=float(model.distance_mm.value[0]),
        outline=outline_of(model),
        source=source,
        grid=grid,
    )
    ratio, ratio_sd = fit.aspect or (1.0, 0.0)
    spread = _spread(model, model.pitch_mm, model.distance_mm, ratio_sd=ratio_sd / ratio)
    table = {
        "kind": model.kind,
        "name": model.name,
        "gel": {name: _plain(published) for name, published in model.gel.items()},
        "camera": {name: np.asarray(held).tolist() for name, held in vars(fit.camera).items()},
        "markers": {"rows": fit.rows, "columns": fit.columns, "pitch_mm": list(_two(model.pitch_mm))},
        "spread": spread,
    }
    seen = [
        f"{source}: {fit.dots} dots of a grid of {fit.rows} x {fit.columns}, "
        f"{fit.off_px:.2g} px off the grid of the fitted camera"
    ]
    if fit.aspect is not None:
        seen.append(
            f"{source}: the picture was resized without its proportions. A millimetre along x has "
            f"{ratio:.3f} ± {ratio_sd:.3f} times the pixels of a millimetre along y. drupe reads frames "
            "of this size as they are. The ratio takes both pitches as exact: if nobody resized the "
            "frames, correct --pitch-mm"
        )
    return Described(table=table, said=(*seen, *_said(model, _forces(model), spread)))


def with_given(model: SensorModel, given: dict[str, tuple[tuple[float, ...], float]]) -> SensorModel:
    """The model with the user's measurements (value, relative spread) in place of published values."""
    given_fields = {
        name: Published(
            value=np.array(value), sd=share * float(np.mean(np.abs(value))), source="given by the user"
        )
        for name, (value, share) in given.items()
    }
    pitch = given_fields.pop("pitch_mm", model.pitch_mm)
    distance = given_fields.pop("distance_mm", model.distance_mm)
    return replace(model, gel=model.gel | given_fields, pitch_mm=pitch, distance_mm=distance)


def _forces(model: SensorModel) -> dict[str, float]:
    """Relative spread of the force by its causes in the gel: modulus, thickness, Poisson's ratio.

    The contact is about as wide as the gel is thick. The force is then proportional to E, and its power of
    the thickness is between -1 (a bonded layer) and 0 (a half-space). It varies with nu as a half-space's
    1/(1 - nu^2).
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

    A force is computed from displacements, so it has their scale's error too. `ratio_sd`: of the focal
    lengths' ratio in a resized picture.
    """
    depth = OF_DEPTH * distance.relative_sd
    scale = float(np.hypot(pitch.relative_sd, ratio_sd))
    force = float(np.linalg.norm([*_forces(model).values(), scale, depth]))
    return {"force": round(force, 4), "displacement": round(scale, 4)}


def _said(model: SensorModel, causes: dict[str, float], spread: dict[str, float]) -> tuple[str, ...]:
    """Each value's source, and the errors that follow."""
    known = {**model.gel, "pitch_mm": model.pitch_mm, "distance_mm": model.distance_mm, **model.fields}
    lines = [
        f"{name} {_words(published)} ({published.source})"
        + (f": ± {causes[name]:.0%} of force" if name in causes else "")
        for name, published in known.items()
        if published is not None
    ]
    lines.append(
        f"force ± {spread['force']:.0%} and displacement ± {spread['displacement']:.1%}, common to "
        "all grasps of this sensor. E has at least this error, but the order of fruit graded with "
        "this sensor does not"
    )
    return (*lines, *([model.notes] if model.notes else []))


def _words(published: Published) -> str:
    return f"{' x '.join(f'{value:g}' for value in published.value)} ± {published.sd:g}"


def _plain(published: Published) -> float | list[float]:
    return float(published.value[0]) if len(published.value) == 1 else published.value.tolist()


def _two(published: Published) -> tuple[float, float]:
    return float(published.value[0]), float(published.value[-1])
