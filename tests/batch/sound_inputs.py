"""A small sound batch, case and sources of `drupe convert`, in all of which nothing is wrong."""

import json
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from tiny_onnx import write_constant_model

from recon.cameras.printed_mat import mat_mapping, standard_mat
from recon.learned.fruit_model import SIDE_PX
from recon.pit.placement import place_pit
from recon.pit.priors import load_prior
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import mesh_bytes
from tactile.readers.recording import GelPad, Recording, write_recording

ROOT = Path(__file__).resolve().parents[2]
BATCH = """category = "mine.toml"
cultivar = "own"
harvest_date = 2026-08-14
pulp_temperature_C = 20.0
poisson_ratio = 0.45
[sensor]
name = "gel"
gel_scale_sd = 0.02
[pit]
offset_sd_mm = 0.5
size_sd = 0.05
[recon]
geometry_model = "model.onnx"
max_faces = 8000
[[grading.classes]]
name = "soft"
E_max_MPa = 0.3
[[grading.classes]]
name = "firm"
[[mismatch]]
effect = "sensor_gain"
parameters = { pad = "left", gain = 1.02 }
"""
CASE = 'category = "nectarine"\npoisson_ratio = 0.45\noffset_sd_mm = 0.5\nsize_sd = 0.05\n'
SENSOR = """kind = "markers-mono"
name = "dots"
serial = "1"
[gel]
thickness_mm = 3.0
E_MPa = 0.25
nu = 0.48
[camera]
image_px = [64, 48]
focal_px = [60.0, 60.0]
centre_px = [31.5, 23.5]
gel_from_camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -16], [0, 0, 0, 1]]
[markers]
rows = 3
columns = 4
pitch_mm = [2.0, 2.0]
"""
GRASP = """fruit_id = "B"
category = "nectarine"
loading = "grasp"
pose_aperture_mm = 60.0
sensor = "sensor.toml"
[pads.left]
pose = [[0, 0, 1, -30], [1, 0, 0, 0], [0, 1, 0, 25], [0, 0, 0, 1]]
[pads.right]
pose = [[0, 0, -1, 30], [-1, 0, 0, 0], [0, 1, 0, 25], [0, 0, 0, 1]]
"""
TABLE = (
    "fruit_id,height_mm,mass_g,shore_oo,diameter_mm,notes\nA,55.9,95,60,56.2,ready\nB,57.6,110,50,60,photos\n"
)
FRAMES = 5
PRESS = [(round(0.1 * t, 1), round(0.05 * t, 2), round(0.02 * t**1.5, 4)) for t in range(30)]
"""A ball's press: time (s), travel (mm) and force (N), with few decimals: they come back exactly."""


def write_sound(root: Path) -> None:
    """`batch/`, `case/` and `sources/` below `root`, in all of which nothing is wrong."""
    directions, faces = ball(3)
    batch, case = root / "batch", root / "case"
    first, second = batch / "fruits" / "A", batch / "fruits" / "B"
    for folder in (first / "grasps", second / "grasps" / "raw", second / "photos", case, root / "sources"):
        folder.mkdir(parents=True)
    (batch / "batch.toml").write_text(BATCH)
    (batch / "fruits.csv").write_text(TABLE)
    (batch / "mat.json").write_text(json.dumps(mat_mapping(standard_mat()), indent=1))
    (batch / "mine.toml").write_bytes((ROOT / "recon" / "pit" / "priors" / "nectarine.toml").read_bytes())
    log_odds = np.zeros((1, 1, 2, 2))
    write_constant_model(
        batch / "model.onnx", {"fruit_log_odds": log_odds}, input_shape=("n", 3, SIDE_PX, SIDE_PX)
    )
    fruit = (28 * directions, faces)
    (first / "fruit.ply").write_bytes(mesh_bytes(*fruit))
    (first / "pit.ply").write_bytes(mesh_bytes(*place_pit(*fruit, load_prior("nectarine"))))
    write_recording(first / "grasps" / "grasp-1.h5", recording())
    rng = np.random.default_rng(5)
    for k, suffix in enumerate((".jpg", ".jpg", ".png")):
        picture = cv2.resize(rng.integers(0, 255, (30, 40, 3), np.uint8), (160, 120))
        cv2.imwrite(str(second / "photos" / f"{k:03d}{suffix}"), picture)
    raw = second / "grasps" / "raw"
    (raw / "grasp.toml").write_text(GRASP)
    (raw / "sensor.toml").write_text(SENSOR)
    rows = [f"{0.05 * t:g},{60.0 - 0.1 * t:g}" for t in range(FRAMES)]
    (raw / "log.csv").write_text("\n".join(["time_s,aperture_mm", *rows]) + "\n")
    for pad in ("left", "right"):
        (raw / pad).mkdir()
        for name in ("reference", *(f"frame_{t:06d}" for t in range(FRAMES))):
            cv2.imwrite(str(raw / pad / f"{name}.png"), dots(rng))
    (case / "case.toml").write_text(CASE)
    for name in ("fruit.ply", "pit.ply"):
        (case / name).write_bytes((first / name).read_bytes())
    (case / "grasp-1.h5").write_bytes((first / "grasps" / "grasp-1.h5").read_bytes())
    _write_sources(root / "sources")


def dots(rng: np.random.Generator) -> UInt8[np.ndarray, "48 64 3"]:
    """What SENSOR's camera sees of its empty gel, drawn eight times finer, with noise of one grey level."""
    fine = np.full((8 * 48, 8 * 64), 170, dtype=np.uint8)
    for x, y in product((-3.0, -1.0, 1.0, 3.0), (-2.0, 0.0, 2.0)):
        at = np.rint(8 * (60 / 16 * np.array([x, y]) + [32.0, 24.0])).astype(int)
        cv2.circle(fine, (int(at[0]), int(at[1])), 15, 30, -1)
    grey = cv2.resize(fine, (64, 48), interpolation=cv2.INTER_AREA)
    return (grey[..., None] + rng.normal(size=(48, 64, 3))).clip(0, 255).astype(np.uint8)


def recording() -> Recording:
    """A short grasp with few markers: air, then a press that grows."""
    rest = np.stack(np.meshgrid(np.arange(-4.0, 5, 2), np.arange(-4.0, 5, 2)), -1).reshape(-1, 2)
    rest = np.column_stack([rest, np.zeros(len(rest))])
    depth = np.clip(np.arange(20) - 8, 0, None) * 0.02
    moved = np.zeros((20, len(rest), 3))
    moved[..., 2] = -depth[:, None]
    moved += np.random.default_rng(2).normal(scale=0.001, size=moved.shape)
    area_mm2, kn_MPa_per_mm, kt_MPa_per_mm = 4.0, 0.3, 0.05
    force_N = -area_mm2 * np.array([kt_MPa_per_mm, kt_MPa_per_mm, kn_MPa_per_mm]) * moved
    pads = []
    for name, side in (("left", -1.0), ("right", 1.0)):
        pose = np.array([[0, 0, -side, side * 28], [-side, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
        poses = np.broadcast_to(pose, (20, 4, 4)).copy()
        poses[:, 0, 3] -= side * depth
        pads.append(
            GelPad(
                name=name,
                pose=poses,
                rest_mm=rest,
                displacement_mm=moved,
                force_N=force_N,
                gel_kn_MPa_per_mm=kn_MPa_per_mm,
                gel_kt_MPa_per_mm=kt_MPa_per_mm,
                thickness_mm=3.0,
                gel_E_MPa=0.25,
                gel_nu=0.48,
            )
        )
    return Recording(
        fruit_id="A", category="nectarine", loading="grasp", support="free", sensor="gel",
        time_s=0.05 * np.arange(20), aperture_mm=60 - 2 * depth, pads=tuple(pads),
    )  # fmt: skip


def _write_sources(folder: Path) -> None:
    made = recording()
    arrays = {"time_s": made.time_s, "aperture_mm": made.aperture_mm}
    lines = ["time_s,aperture_mm,pad,marker,x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm,fx_N,fy_N,fz_N"]
    for k, pad in enumerate(made.pads):
        assert isinstance(pad, GelPad)
        for field in ("rest_mm", "displacement_mm", "force_N", "pose"):
            arrays[f"pads/{pad.name}/{field}"] = getattr(pad, field)
        for t in range(3):
            for m, rest in enumerate(pad.rest_mm):
                held = (*rest, *pad.displacement_mm[t, m], *pad.force_N[t, m])
                lines.append(",".join(f"{v:.6g}" for v in (0.05 * t, 60, k, m, *held)))
    np.savez(folder / "fields.npz", **arrays)
    (folder / "fields.csv").write_text("\n".join(lines) + "\n")
    gel = "[gel]\ngel_kn_MPa_per_mm = 0.3\ngel_kt_MPa_per_mm = 0.05"
    sensor = SENSOR.replace("markers-mono", "fields").replace("[gel]", gel)
    (folder / "sensor.toml").write_text(sensor)
    rows = [f"{1e3 * t:g};{travel:g};{force:g}" for t, travel, force in PRESS]
    (folder / "press.csv").write_text("\n".join(["t_ms;travel_mm;force_N", *rows]) + "\n")
    tac3d = folder / "tac3d" / "AD2"
    tac3d.mkdir(parents=True)
    pad = made.pads[0]
    assert isinstance(pad, GelPad)
    for name, values in {
        "index": np.arange(20),
        "sendTimestamp": made.time_s,
        "3D_Positions": pad.rest_mm + pad.displacement_mm,
        "3D_Displacements": pad.displacement_mm,
        "3D_Forces": -pad.force_N,
        "3D_ResultantForce": -pad.force_N.sum(axis=1)[:, None],
        "3D_ResultantMoment": np.zeros((20, 1, 3)),
    }.items():
        np.save(tac3d / f"{name}.npy", values)
