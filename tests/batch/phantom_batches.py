"""Batches of cast specimens of PDMS: balls in a grasp and a cube under a press, with rigid cores and without.

How they move and what the pads feel is CalculiX's: tests/data/phantom-ball-calculix.csv and
benchmarks/forward. Both are linear and of another modulus; their forces are scaled to E_MPA. Gels are stiff
against PDMS: pads keep their shape.
"""

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from recon.surface.mesh_file import write_mesh
from samples.mismatch.marker_sensor import SensorNoise, measured
from tactile.readers.recording import GelPad, Recording, write_recording

ROOT = Path(__file__).parents[2]
FORWARD, BALLS = ROOT / "benchmarks" / "forward", ROOT / "tests" / "data" / "phantom-ball-calculix.csv"
E_MPA, NU = 0.044, 0.45
"""PDMS of the paper (Table I); Poisson's ratio of the forward solutions."""
CUBE_E_MPA = 0.1
"""Of the forward solutions of cube and cuboid."""
BALL_MM, CORE_MM = 20.0, 8.0
PITCH_MM = 0.65
CUBE_MM, CUBE_CORE_MM = 30.0, 12.0
NOISE = SensorNoise(
    displacement_mm=0.002,
    reference_mm=0.001,
    force_N=1.5e-4,
    reference_N=7e-5,
    displacement_step_mm=2.0**-16,
    force_step_N=2.0**-16,
)
"""A quiet marker gel: single markers of a Tac3D scatter by 0.1 to 0.4 mN from frame to frame. Most carry 1 to
4 mN here; with twice the noise of force single recordings of the cored ball come out 0.1 to 1.7 % too low."""
AIR_FRAMES, AIR_STEP_MM, HOLD_FRAMES = 30, 0.05, 4
HEADER = 'category = "phantom"\npoisson_ratio = 0.45\n[flesh]\nmodel = "linear"\n'
Surface = tuple[np.ndarray, np.ndarray]


def phantom_batch(
    folder: Path, settings: str, specimens: dict[str, tuple[Surface, Surface | None, Recording]]
) -> Path:
    """A batch of ready meshes: the specimen, its core as pit.ply where there is one, and the recording."""
    for name, (skin, core, recording) in specimens.items():
        where = folder / "fruits" / name
        (where / "grasps").mkdir(parents=True)
        write_mesh(where / "fruit.ply", *skin)
        if core is not None:
            write_mesh(where / "pit.ply", *core)
        write_recording(where / "grasps" / "grasp-1.h5", replace(recording, fruit_id=name))
    (folder / "batch.toml").write_text(settings)
    (folder / "fruits.csv").write_text("\n".join(["fruit_id", *specimens]) + "\n")
    return folder


def ball(radius_mm: float) -> Surface:
    """About the origin, 5120 triangles."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius_mm)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)


def box(*sides_mm: float, edge_mm: float = np.inf) -> Surface:
    """About the origin; twelve triangles, cut in four until no edge is longer than `edge_mm`."""
    mesh = trimesh.creation.box(sides_mm)
    if np.isfinite(edge_mm):
        mesh = mesh.subdivide_to_size(edge_mm)
        mesh.merge_vertices()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)


def grasped_ball(*, core: bool, rng: np.random.Generator) -> Recording:
    """Two plates close on the ball along x; a marker rides on the skin from where it first touches."""
    with BALLS.open() as table:
        rows = np.array([[float(v) for v in line.values()] for line in csv.DictReader(table)])
    rows = rows[rows[:, 0] == (CORE_MM if core else 0.0)]
    contacts = np.unique(rows[:, 1])
    levels = [rows[rows[:, 1] == contact] for contact in contacts]
    line = PITCH_MM * np.arange(-9.5, 10.0)
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    r = np.linalg.norm(flat, axis=1)
    spread = np.zeros((len(levels) + 1, len(flat)))
    force = np.zeros((len(levels) + 1, len(flat), 3))
    for k, level in enumerate(levels, start=1):
        spread[k] = np.interp(r, level[:, 3], level[:, 4])
        force[k, :, 2] = -E_MPA * _pressure_MPa(level[:, 3], level[:, 6], r) * PITCH_MM**2
    onset = np.argmax(contacts[:, None] > r, axis=0) + 1
    touches = np.vstack([np.zeros(len(r), dtype=bool), contacts[:, None] > r])
    outward = flat / r[:, None]
    first = spread[onset, np.arange(len(r))] * touches[-1]
    rest = np.column_stack([flat + first[:, None] * outward, np.zeros(len(flat))])
    slid = np.zeros_like(force)
    slid[:, :, :2] = np.where(touches, spread - first, 0.0)[:, :, None] * outward
    travel = np.concatenate([[0.0], [level[0, 2] for level in levels]])
    order = _course(len(levels))
    travel = np.concatenate([_approach(), travel[order]])
    pads = []
    for name, side in (("left", -1.0), ("right", 1.0)):
        pose = np.tile(np.eye(4), (len(travel), 1, 1))
        pose[:, :3, :3] = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -side], [-side, 0.0, 0.0]])
        pose[:, 0, 3] = side * (BALL_MM - travel)
        pads.append(_felt(name, pose, rest, _after_air(slid[order]), _after_air(force[order]), rng))
    return _recording("grasp", 2 * (BALL_MM - travel), pads)


def glued_pads(name: str, *, rng: np.random.Generator) -> Recording:
    """Pads glued to a square of a face go 1 mm in, in ten steps: one on top of the cube (a press solution)
    whose base is held, or one at each end of the cuboid (a grasp).
    """
    with np.load(FORWARD / f"{name}.npz") as data:
        kept = {key: data[key] for key in data.files}
    edge, place, force = float(kept["patch_edge_mm"][0]), kept["place_mm"], kept["force_N"][-1].astype(float)
    axis = int(kept["patch_axis"][0])
    centre = kept["patch_centre_mm"][0]
    for mirror in kept["mirrors"]:
        if mirror != axis:
            flip = np.where(np.arange(3) == mirror, -1.0, 1.0)
            place, force = np.vstack([place, place * flip]), np.vstack([force, force * flip])
    line = np.linspace(-edge / 2, edge / 2, 11)
    turn = _into(axis, -1.0)
    local, pushed = (place - centre) @ turn, force @ turn
    hat = np.maximum(0.0, 1 - np.abs(local[:, :2, None] - line) / (line[1] - line[0]))
    weight = np.einsum("na,nb->nab", hat[:, 0], hat[:, 1]).reshape(len(local), -1)
    marker_N = E_MPA / CUBE_E_MPA * weight.T @ pushed
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    rest = np.column_stack([flat, np.zeros(len(flat))])
    share = np.linspace(0, 1, 11)[_course(10)]
    travel = np.concatenate([_approach(), share])
    press = name.startswith("press")
    pads = []
    for pad, way in [("tip", -1.0)] if press else [("left", 1.0), ("right", -1.0)]:
        pose = np.tile(np.eye(4), (len(travel), 1, 1))
        pose[:, :3, :3] = _into(axis, way)
        pose[:, :3, 3] = -way * centre
        pose[:, axis, 3] += way * travel
        force_N = share[:, None, None] * marker_N
        pads.append(_felt(pad, pose, rest, _after_air(np.zeros_like(force_N)), _after_air(force_N), rng))
    if press:
        return _recording("press", travel, pads)
    return _recording("grasp", 2 * (abs(centre[axis]) - travel), pads)


def _into(axis: int, way: float) -> np.ndarray:
    """Columns: a pad's x, y and z, the last along an axis of the specimen."""
    z = way * np.eye(3)[axis]
    x = np.eye(3)[(axis + 1) % 3]
    return np.column_stack([x, np.cross(z, x), z])


def _pressure_MPa(r_mm: np.ndarray, ring_N: np.ndarray, at_mm: np.ndarray) -> np.ndarray:
    """Forces on rings over the rings' areas (each the integral of its linear hat), read off at radii."""
    low, high = np.diff(r_mm, prepend=r_mm[0]), np.diff(r_mm, append=r_mm[-1])
    area_mm2 = np.pi * (low * (r_mm - low / 3) + high * (r_mm + high / 3))
    return np.interp(at_mm, r_mm, ring_N / area_mm2, right=0.0)


def _course(levels: int) -> np.ndarray:
    """In steps to the deepest level, a hold, and back to the first touch."""
    return np.concatenate([np.arange(levels + 1), np.full(HOLD_FRAMES, levels), np.arange(levels)[::-1]])


def _approach() -> np.ndarray:
    """Travel in the air, up to one step before the first touch."""
    return -AIR_STEP_MM * np.arange(AIR_FRAMES, 0, -1)


def _after_air(values: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((AIR_FRAMES, *values.shape[1:])), values])


def _felt(
    name: str,
    pose: np.ndarray,
    rest_mm: np.ndarray,
    displacement_mm: np.ndarray,
    force_N: np.ndarray,
    rng: np.random.Generator,
) -> GelPad:
    """One pad of a recording, frame by frame, with the gel's noise."""
    moved, pushed = measured(displacement_mm, force_N, NOISE, rng)
    return GelPad(
        name=name,
        pose=pose,
        rest_mm=rest_mm,
        displacement_mm=moved,
        force_N=pushed,
        gel_kn_MPa_per_mm=5.0,
        gel_kt_MPa_per_mm=1.0,
    )


def _recording(loading: str, aperture_mm: np.ndarray, pads: Sequence[GelPad]) -> Recording:
    return Recording(
        fruit_id="",
        category="phantom",
        loading=loading,
        support="base" if loading == "press" else "free",
        sensor="marker gel",
        time_s=0.05 * np.arange(len(aperture_mm)),
        aperture_mm=aperture_mm,
        pads=tuple(pads),
    )
