"""Fruit for field_mistakes.py: read from folders, or drawn cheaply with a contact that needs no solver."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from script import Half, in_half

from recon.surface.mesh_file import read_mesh
from samples.fruit import fruit_of_seed, scanned_mesh
from samples.grasp_plan import hold_along, two_cycles
from samples.mismatch.marker_sensor import DEFAULT_SENSOR, SensorNoise, measured
from tactile.readers.recording import GelPad, Recording, read_recording
from tactile.registration import depth_along


@dataclass(frozen=True, kw_only=True)
class Fruit:
    """One fruit as its folder has it, and what is true of it."""

    name: str
    number: int
    category: str
    E_MPa: float
    vertices: np.ndarray
    faces: np.ndarray
    pit: tuple[np.ndarray, np.ndarray] | None
    recordings: tuple[Recording, ...]
    poisson_ratio: float = 0.45


def fruit_of(folder: Path) -> Fruit | None:
    """The fruit in a folder; None where none is."""
    if not (folder / "fruit.ply").is_file():
        return None
    truth, of_all = folder / "truth.json", folder.parent / "answers.json"
    if truth.is_file():
        answer = json.loads(truth.read_text())
    elif of_all.is_file() and folder.name in (answers := json.loads(of_all.read_text())):
        answer = answers[folder.name]
    else:
        return None
    number = re.findall(r"\d+", folder.name)
    pit_file = folder / "pit.ply"
    category = str(answer["category"])
    return Fruit(
        name=str(answer.get("fruit_id", folder.name)),
        number=int(number[-1]) if number else 0,
        category={"pdms_ball": "phantom"}.get(category, category),
        E_MPa=float(answer["E_MPa"]),
        vertices=read_mesh(folder / "fruit.ply")[0],
        faces=read_mesh(folder / "fruit.ply")[1],
        pit=read_mesh(pit_file) if pit_file.is_file() else None,
        recordings=tuple(read_recording(path) for path in sorted(folder.glob("grasp-*.h5"))),
    )


def fruits_in(paths: Sequence[Path], half: Half) -> dict[Path, Fruit]:
    """All fruit below the paths by their folders, of one half of the numbers."""
    folders = (
        f for path in paths for f in ([path] if (path / "fruit.ply").is_file() else sorted(path.iterdir()))
    )
    fruits = {folder: fruit_of(folder) for folder in folders if folder.is_dir()}
    return {folder: fruit for folder, fruit in fruits.items() if fruit and in_half(fruit.number, half)}


def partner(fruits: Sequence[Fruit], k: int) -> Fruit:
    """The next fruit of the same category, else the next."""
    rest = [*fruits[k + 1 :], *fruits[:k]]
    same = [fruit for fruit in rest if fruit.category == fruits[k].category]
    return (same or rest or [fruits[k]])[0]


KN_MPA_PER_MM, KT_MPA_PER_MM = 0.22, 0.055


def cheap_fruit(seed: int) -> Fruit:
    """A nectarine grasped twice, where each marker is indented by a share of what it overlaps the true skin.

    The share, which flesh and gel set together, is drawn from what simulations give (0.08 to 0.45); shear is
    a tenth of it, outwards. The mesh is scanned with 0.1 mm of error; noise is that of
    samples.mismatch.marker_sensor. It tests what checks say of fields, jaws and places, not E.
    """
    rng = np.random.default_rng([19, seed])
    fruit = fruit_of_seed(f"C{seed:03d}", seed=9000 + seed, E_MPa=0.5)
    true, faces = scanned_mesh(fruit, cells=40, error_mm=1e-6)
    mesh, mesh_faces = scanned_mesh(fruit, cells=28, error_mm=0.1)
    recordings = []
    first = float(rng.uniform(25.0, 65.0))
    for k in range(2):
        hold = hold_along(
            fruit, azimuth_deg=first + 90.0 * k + float(rng.normal(0, 8)), tilt_deg=float(rng.normal(0, 4))
        )
        way = two_cycles(deepest_mm=float(rng.uniform(1.0, 1.6)), speed_mm_per_s=float(rng.uniform(0.5, 4.0)))
        share = float(np.exp(rng.uniform(np.log(0.08), np.log(0.45))))
        rest, pads = DEFAULT_SENSOR.rest_mm, []
        for side, name in enumerate(("left", "right")):
            turn = hold.turns[side]
            origin = hold.origins(float(way.travel_mm[0]))[side]
            ahead = depth_along(rest @ turn.T + origin, turn[:, 2], true[faces])
            closed = way.travel_mm - way.travel_mm[0]
            over = np.maximum(closed[:, None] - np.nan_to_num(ahead, nan=1e3), 0.0) * share
            moved = np.zeros((*over.shape, 3))
            moved[:, :, 2] = -over
            moved[:, :, :2] = 0.1 * over[:, :, None] * rest[:, :2] / 10.0
            stiffness = np.array([KT_MPA_PER_MM, KT_MPA_PER_MM, KN_MPA_PER_MM]) * DEFAULT_SENSOR.pitch_mm**2
            felt, pushed = measured(moved, -stiffness * moved, SensorNoise(), rng)
            pose = np.broadcast_to(np.eye(4), (len(over), 4, 4)).copy()
            pose[:, :3, :3] = turn
            pose[:, :3, 3] = [hold.origins(float(t))[side] for t in way.travel_mm]
            pads.append(
                GelPad(
                    name=name,
                    pose=pose,
                    rest_mm=rest,
                    displacement_mm=felt,
                    force_N=pushed,
                    gel_kn_MPa_per_mm=KN_MPA_PER_MM,
                    gel_kt_MPa_per_mm=KT_MPA_PER_MM,
                )
            )
        gap = float(np.linalg.norm(hold.touch_mm[1] - hold.touch_mm[0]))
        recordings.append(
            Recording(
                fruit_id=fruit.fruit_id,
                category="nectarine",
                loading="grasp",
                support="free",
                sensor="20x20 marker gel",
                time_s=way.time_s,
                aperture_mm=gap - 2 * way.travel_mm,
                pads=tuple(pads),
            )
        )
    return Fruit(
        name=fruit.fruit_id,
        number=seed,
        category="nectarine",
        E_MPa=fruit.E_MPa,
        vertices=mesh,
        faces=mesh_faces,
        pit=None,
        recordings=tuple(recordings),
    )
