"""Our own simulator of truth against recordings of an independent one, frame by frame, without noise.

    python benchmarks/truth_verification.py FOLDER [--body ball ...] [--grasp 2 3 1 4] [--cells 4 5] [--steps 1]

FOLDER holds the bodies without mismatch (SOURCE.md): `truth.json`, `grasp-K.h5` and `dense/grasp-K.h5` of each.
The pads move as the recording says. For each grasp a table by phase: rms difference of the markers' displacement
along the pad's normal and along each tangent (um, over markers above a tenth of the frame's peak pressure), of
their force (percent of the largest marker force), and the largest difference of a pad's total normal force
(percent of the frame's, over frames above a tenth of the peak force). With several `--cells` a last line compares the
two finest meshes with each other.
"""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from samples.fruit import SampleFruit, SamplePit
from samples.gel_contact import Gel
from samples.graded_bricks import BrickGrading
from samples.grasp_plan import Hold
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.four_grasps import CaseGrasp
from samples.mismatch.marker_sensor import MarkerSensor
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.nulls import neo_hookean_body
from samples.mismatch.protocol import CLEARANCE_MM, Motion
from samples.mismatch.true_recording import PadTruth, grasped, grip_of
from tactile.io.recording import Recording, read_recording

TOUCHED = 0.1
"""Share of the frame's peak pressure from which on a marker counts, and of the peak force for a frame."""
PHASES = ("load", "hold", "shear", "unload")
PADS = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class FormulaSkin:
    """The external bodies' skin: an ellipsoid p, scaled along its rays by f(p / |p|) (SOURCE.md)."""

    half_axes_mm: tuple[float, float, float]
    suture: float
    stem: float
    lop: float
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def radius_mm(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """r(d) in mm for unit directions."""
        x, y, z = directions.T
        azimuth, polar = np.arctan2(y, x), np.arccos(np.clip(z, -1.0, 1.0))
        f = 1 - self.suture * np.exp(-((azimuth / 0.22) ** 2)) * np.sin(polar) ** 2
        f += -self.stem * np.exp(-((polar / 0.35) ** 2)) + self.lop * (y * x + z * y)
        return np.asarray(f / np.linalg.norm(directions / np.array(self.half_axes_mm), axis=1))

    def points_mm(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The skin's points in the fruit frame."""
        return np.asarray(self.radius_mm(directions)[:, None] * directions)


def main() -> None:
    """Print one table for each body and grasp."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--body", nargs="+", default=["ball", "nectarine", "nectarine-hard", "nectarine-soft", "plum"])
    parser.add_argument("--grasp", nargs="+", type=int, default=[2, 3, 1, 4])
    parser.add_argument("--cells", nargs="+", type=int, default=[4])
    parser.add_argument("--layers", type=int, default=None)
    parser.add_argument("--steps", type=int, default=1, help="instants from frame to frame")
    parser.add_argument("--points", type=int, default=4, help="gel points along each side of a skin cell")
    parser.add_argument("--save", type=Path, default=None)
    asked = parser.parse_args()
    for body in asked.body:
        for number in asked.grasp:
            verify(asked.folder / body, number, asked)


def verify(folder: Path, number: int, asked: argparse.Namespace) -> None:
    """Simulate one grasp on each mesh and print how it differs."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    theirs = read_recording(folder / "dense" / f"grasp-{number}.h5")
    grasp = as_recorded(theirs)
    phase = phases(grasp.motion)
    recorded = pads_of(theirs)
    earlier = None
    for cells in asked.cells:
        start = time.process_time()
        grading = BrickGrading(cells=cells, layers=asked.layers or (cells + 1) // 2)
        stands = meshed_fruit(as_drawn(truth, theirs), grasp, fineness=grading)
        body = neo_hookean_body(stands)
        meshed = time.process_time()
        ours = grasped(grasp, grip_of(stands, gel=stands.sensor.gel, points=asked.points), body, steps=asked.steps)
        spent = time.process_time()
        print(
            f"{folder.name} grasp {number}: {cells} along a side, {stands.flesh.unknowns} unknowns, "
            f"{len(stands.dofs)} in the patches, {meshed - start:.0f} + {spent - meshed:.0f} CPU-s", flush=True
        )  # fmt: skip
        table(ours.pads, recorded, phase)
        if asked.save:
            np.savez(
                asked.save / f"{folder.name}-{number}-{cells}.npz",
                u=np.stack([p.displacement_mm for p in ours.pads]),
                f=np.stack([p.force_N for p in ours.pads]),
            )
        if earlier is not None:
            print("  against the mesh before:")
            table(ours.pads, earlier, phase)
        earlier = ours.pads


def as_drawn(truth: dict[str, Any], theirs: Recording) -> DrawnFruit:
    """The body of `truth.json` in the words of samples."""
    axes, centre, half = (tuple(truth[k]) for k in ("axes", "pit_centre", "pit"))
    skin = FormulaSkin(half_axes_mm=axes, **{k: truth[k] for k in ("suture", "stem", "lop")})
    pit = SamplePit(centre_mm=centre, semi_axes_mm=half)
    fruit = SampleFruit(
        fruit_id=theirs.fruit_id, seed=0, skin=skin, pit=pit, E_MPa=truth["E"], poisson_ratio=truth["nu"],
        ripeness=0.5,
    )  # fmt: skip
    gel = Gel(kn_MPa_per_mm=truth["kn"], kt_MPa_per_mm=truth["kt"], friction=truth["friction"])
    places = np.unique(theirs.pads[0].rest_mm[:, 0])
    sensor = MarkerSensor(gel=gel, markers=len(places), pitch_mm=float(places[1] - places[0]))
    return DrawnFruit(category=truth["category"], fruit=fruit, prior=pit, depth_mm=0.0, sensor=sensor)


def as_recorded(theirs: Recording) -> CaseGrasp:
    """The way of the pads, read from their poses; a corner at first touch comes before the first press."""
    poses = [p.pose for p in theirs.pads]
    turns = (poses[0][0, :3, :3], poses[1][0, :3, :3])
    ways = [(p[:, :3, 3] - p[0, :3, 3]) @ p[0, :3, :3] for p in poses]
    assert np.abs(ways[0][:, 2] - ways[1][:, 2]).max() < 1e-9 and np.abs(ways[1][:, :2]).max() < 1e-9
    touch = np.stack([p[0, :3, 3] + CLEARANCE_MM * p[0, :3, 2] for p in poses])
    first = int(np.argmax(ways[0][:, 2] > 0))
    add = lambda x, value: np.insert(x, first, value)  # noqa: E731
    motion = Motion(
        time_s=add(theirs.time_s, theirs.time_s[first - 1] + 0.1),
        travel_mm=add(ways[0][:, 2] - CLEARANCE_MM, 0.0),
        shear_mm=add(ways[0][:, 0], 0.0),
        recorded=add(np.ones(len(theirs.time_s), dtype=bool), False),
    )
    return CaseGrasp(
        name=theirs.fruit_id, hold=Hold(turns=turns, touch_mm=touch), motion=motion, mesh=0, turned=False
    )


def phases(motion: Motion) -> dict[str, Bool[np.ndarray, " t"]]:
    """Which frames belong to each phase; frames in the air belong to none."""
    travel, shear = motion.travel_mm[motion.recorded], motion.shear_mm[motion.recorded]
    closer, aside = np.diff(travel, prepend=travel[0]), np.diff(shear, prepend=shear[0])
    touches = travel > 0
    return {
        "load": touches & (closer > 0),
        "hold": touches & (closer == 0) & (aside == 0),
        "shear": touches & (np.abs(aside) > 1e-9),
        "unload": touches & (closer < 0),
    }


def pads_of(theirs: Recording) -> tuple[PadTruth, PadTruth]:
    """A recording's pads, left then right."""
    left, right = (
        PadTruth(pose=p.pose, displacement_mm=np.asarray(p.displacement_mm, float), force_N=np.asarray(p.force_N, float))
        for p in theirs.pads
    )
    return left, right


def table(
    ours: tuple[PadTruth, PadTruth], theirs: tuple[PadTruth, PadTruth], phase: dict[str, Bool[np.ndarray, " t"]]
) -> None:
    """One line for each phase and pad."""
    print("  phase   pad    normal tangent   all um  marker N %   total force % (rms, peak frame)  shear force %")
    for name, frames in phase.items():
        for side, pad in enumerate(PADS):
            if not frames.any():
                continue
            u, v = ours[side].displacement_mm[frames], theirs[side].displacement_mm[frames]
            f, g = ours[side].force_N[frames], theirs[side].force_N[frames]
            touched = g[..., 2] > TOUCHED * g[..., 2].max(axis=1, keepdims=True)
            away = 1e3 * (u - v)[touched]
            normal, tangent = rms(away[:, 2]), rms(away[:, :2])
            total, other = f.sum(axis=1), g.sum(axis=1)
            heavy = other[:, 2] > TOUCHED * theirs[side].force_N[..., 2].sum(axis=1).max()
            relative = 100 * (total - other) / other[:, 2:]
            top = int(np.argmax(other[:, 2]))
            marker = 100 * rms((f - g)[touched]) / g[..., 2].max()
            print(
                f"  {name:7s} {pad:5s} {normal:7.2f} {tangent:7.2f} {rms(away):8.2f} {marker:9.2f}   "
                f"{rms(relative[heavy, 2]):8.3f} {relative[top, 2]:8.3f} {rms(relative[heavy, :2]):14.3f}", flush=True
            )  # fmt: skip


def rms(x: Float[np.ndarray, "*n"]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(x)))) if np.size(x) else float("nan")


if __name__ == "__main__":
    main()
