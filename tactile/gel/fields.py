"""Displacement and force at every marker of a gel, from the markers in its cameras' pictures.

A marker's ray determines its place in the plane. Its depth comes from two cameras (`markers-stereo`). With
one camera (`markers-mono`) it comes from the slab model alone: pressure on the face also moves the markers
sideways. Sideways motion constrains the depth only weakly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactile.gel.force_inverse import InvertedForce, most_likely_hyperparameters
from tactile.gel.grid import PriorHyperparameters, gel_grid
from tactile.gel.slab import FLAT_TO, GelSlab
from tactile.gel_camera import mm_per_px, on_face, ray_information, triangulated
from tactile.markers.tracking import TrackedMarkers
from tactile.noise import MEDIAN_OF_GAUSSIAN
from tactile.sensors import GelCamera, Sensor
from tactile.tactile_failure import TactileFailure, TactileProblem

LEAST_NOISE_PX = 0.01
"""Least noise of a marker's place, px: synthetic frames may have none, real ones have 0.027 (eight clips)."""
MONO_SLAB_SD_MM, MONO_SIDES_SD_MM = 0.006, 0.001
"""Error of the slab model along the face, which is added to the noise with one camera. Values for an infinite
slab and a known outline (`benchmarks/gel_image_errors.py --draws 5`)."""
DEPTH_ROUNDS = 2
"""Iterations between depth and places with one camera. Set by hand."""
FRAMES_TO_CHOOSE_FROM = 3
"""Frames with large displacements that determine the prior: each costs several inversions. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class GelFields:
    """Displacement and force of every marker in every frame (pad frame; the force acts on the fruit).

    The displacement of a hidden marker is NaN. `touching`: nodes in contact. `solver` computes the forces.
    """

    rest_mm: Float[np.ndarray, "n 3"]
    displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    touching: Bool[np.ndarray, "t m"]
    hyperparameters: PriorHyperparameters
    solver: InvertedForce


def slab_of(sensor: Sensor) -> GelSlab:
    """The sensor's gel. Raises TactileFailure (unreadable-sensor) if the description lacks a constant."""
    if sensor.thickness_mm is None or sensor.E_MPa is None or sensor.nu is None:
        raise TactileProblem.UNREADABLE_SENSOR.failure(
            f"{sensor.name}: forces need the gel: found thickness_mm {sensor.thickness_mm}, E_MPa "
            f"{sensor.E_MPa}, nu {sensor.nu}, expected all three; add them to [gel] or run drupe "
            "calibrate",
        )
    return GelSlab(thickness_mm=sensor.thickness_mm, E_MPa=sensor.E_MPa, nu=sensor.nu, outline=sensor.outline)


def fields_of(
    sensor: Sensor,
    tracked: TrackedMarkers,
    *,
    second: TrackedMarkers | None = None,
    hyperparameters: PriorHyperparameters | None = None,
) -> GelFields:
    """Displacement and force of a whole recording.

    `second` is the other camera's tracking of the same markers (stereo). `hyperparameters` None: those most
    likely for the frames with the largest displacements. Raises TactileFailure (unreadable-sensor) if the
    sensor's description lacks what its kind needs. It also raises if markers lie outside the described gel,
    or on a dome that the description lacks.
    """
    frames = len(tracked.time_s)
    noise_px = max(LEAST_NOISE_PX, frame_noise(tracked.position_px))
    slab, camera = slab_of(sensor), _needed(sensor, sensor.camera, "camera")
    _refuse_dome(sensor, slab, tracked.rest_mm)
    _refuse_outside(sensor, tracked.rest_mm)
    if mono := sensor.kind != "markers-stereo":
        rest_mm = _on_planes(camera, tracked.reference_px, tracked.rest_mm[:, 2])
        seen = np.array([_on_planes(camera, pixels, rest_mm[:, 2]) for pixels in tracked.position_px])
        slab_sd_mm = MONO_SLAB_SD_MM if slab.outline is None else MONO_SIDES_SD_MM
        _, information = ray_information(
            camera, tracked.reference_px, noise_px=noise_px, z_mm=tracked.rest_mm[:, 2]
        )
        information *= (noise_px / (noise_px + slab_sd_mm / mm_per_px(camera))) ** 2
    else:
        cameras = (camera, _needed(sensor, sensor.second_camera, "second_camera"))
        if second is None:
            raise _refusal(sensor, "the second camera's markers are missing; track both cameras' images")
        both_px = (tracked.reference_px, second.reference_px)
        rest_mm, information = triangulated(cameras, both_px, noise_px=noise_px)
        pairs = zip(tracked.position_px, second.position_px, strict=True)
        seen = np.array([triangulated(cameras, pair)[0] for pair in pairs])
    seen -= rest_mm
    grid = gel_grid(slab, rest_mm)
    if hyperparameters is None:
        moved = np.nan_to_num(np.sqrt(np.nanmean(seen**2, axis=(1, 2))))
        strongest = np.argsort(moved)[::-1][: max(1, frames // 3)]
        picks = strongest[np.linspace(0, len(strongest) - 1, FRAMES_TO_CHOOSE_FROM).astype(int)]
        hyperparameters = most_likely_hyperparameters(grid, information, seen[picks])
    solver = InvertedForce(grid, information, hyperparameters)
    force = np.zeros(seen.shape)
    touching = np.zeros((frames, len(grid.nodes_mm)), dtype=bool)
    before = None
    for t in range(frames):
        contact = solver.solve(seen[t], before=before)
        for _ in range(DEPTH_ROUNDS if mono else 0):
            z_mm = rest_mm[:, 2] + contact.displacement_mm[:, 2]
            seen[t] = _on_planes(camera, tracked.position_px[t], z_mm) - rest_mm
            contact = solver.solve(seen[t], before=contact.touching)
        before = touching[t] = contact.touching
        force[t] = contact.force_N
    return GelFields(
        rest_mm=rest_mm,
        displacement_mm=seen,
        force_N=force,
        touching=touching,
        hyperparameters=hyperparameters,
        solver=solver,
    )


def frame_noise(values: Float[np.ndarray, "t n c"]) -> float:
    """Noise of one value in one frame by second differences in time: 0.2 quantile of the frames' medians."""
    if len(values) < 3:
        return 0.0
    bends = np.abs(values[2:] - 2 * values[1:-1] + values[:-2]).reshape(len(values) - 2, -1)
    usable = [float(np.nanmedian(row)) for row in bends if np.isfinite(row).any()]
    return float(np.quantile(usable, 0.2)) / MEDIAN_OF_GAUSSIAN / np.sqrt(6.0) if usable else 0.0


def _on_planes(
    camera: GelCamera, pixels: Float[np.ndarray, "n 2"], z_mm: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    points = on_face(camera, np.nan_to_num(pixels), z_mm)
    return np.where(np.isfinite(pixels).all(axis=1)[:, None], points, np.nan)


def _needed(sensor: Sensor, camera: GelCamera | None, name: str) -> GelCamera:
    if camera is None:
        raise _refusal(sensor, f"its description has no {name}; add a table [{name}]")
    return camera


def _refuse_dome(sensor: Sensor, slab: GelSlab, rest_mm: Float[np.ndarray, "n 3"]) -> None:
    """Raises TactileFailure if the markers deviate from the described face by more than a tilt."""
    basis = np.column_stack([rest_mm[:, :2], np.ones(len(rest_mm))])
    face = 0.0 if slab.outline is None else slab.outline.face_mm(rest_mm[:, 0], rest_mm[:, 1])
    over = rest_mm[:, 2] - face
    off = over - basis @ np.linalg.lstsq(basis, over, rcond=None)[0]
    if np.ptp(off) > FLAT_TO * slab.thickness_mm:
        raise _refusal(
            sensor,
            f"its gel is a dome ({np.ptp(off):.2f} mm high, {slab.thickness_mm:g} mm thick). Give "
            'face_radius_mm and size_mm under [gel], or use the maker\'s own forces (kind = "fields")',
        )


def _refuse_outside(sensor: Sensor, rest_mm: Float[np.ndarray, "n 3"]) -> None:
    """Raises TactileFailure for markers outside the outline: it has another unit or is another gel's."""
    if sensor.outline is None:
        return
    size, centre = np.array(sensor.outline.size_mm), np.array(sensor.outline.centre_mm)
    outside = (np.abs(rest_mm[:, :2] - centre) > size / 2).any(axis=1)
    if outside.any():
        x, y = rest_mm[np.argmax(outside), :2]
        raise _refusal(
            sensor,
            f"found {int(outside.sum())} of {len(rest_mm)} markers outside the gel (one at ({x:.1f}, "
            f"{y:.1f}) mm), expected all within size_mm {size.tolist()} around centre_mm "
            f"{centre.tolist()}; correct [gel]",
        )


def _refusal(sensor: Sensor, detail: str) -> TactileFailure:
    return TactileProblem.UNREADABLE_SENSOR.failure(f"{sensor.name}: {detail}")
