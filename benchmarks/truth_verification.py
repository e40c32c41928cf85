"""The simulator of truth against recordings of an independent one, frame by frame, without noise.

    python benchmarks/truth_verification.py FOLDER [--body ball --body ...] [--grasp 2 --grasp ...]

FOLDER holds bodies without mismatch: `truth.json` and `dense/grasp-K.h5` of each (its SOURCE.md has the
formulas). The pads move as the recording says. For each grasp a table by phase and pad: rms difference of the
markers' displacement along the normal and along each tangent (um, over markers above a tenth of the frame's
peak pressure), of their force (percent of the largest), of the pad's total normal and shear force (percent of
its normal force, over frames above a tenth of the peak, and in the frame of the greatest force).
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Bool, Float
from script import run

from samples.fruit import SampleFruit, SamplePit, Skin
from samples.gel_contact import Gel
from samples.grasp_plan import CLEARANCE_MM, Hold, Motion, PlannedGrasp
from samples.mismatch.marker_sensor import MarkerSensor
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.true_recording import PadTruth, grasped, grip_of
from tactile.readers.recording import GelPad, Recording, read_recording

BODIES = ("ball", "nectarine", "nectarine-hard", "nectarine-soft", "plum")
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


def main(folder: Path, body: list[str] | None = None, grasp: list[int] | None = None) -> None:
    """Print one table for each body and grasp."""
    for name in body or BODIES:
        for number in grasp or (2, 3, 1, 4):
            verify(folder / name, number)


def verify(folder: Path, number: int) -> None:
    """Simulate one grasp and print how it differs."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    theirs = read_recording(folder / "dense" / f"grasp-{number}.h5")
    grasp = as_recorded(theirs)
    start = time.process_time()
    fruit, sensor = as_sample(truth, theirs)
    stands = meshed_fruit(fruit, grasp, sensor=sensor)
    body = sound_body(stands)
    meshed = time.process_time()
    ours = grasped(grasp, grip_of(stands, gel=stands.sensor.gel), body)
    spent = time.process_time()
    print(
        f"{folder.name} grasp {number}: {stands.flesh.unknowns} unknowns, "
        f"{len(stands.dofs)} in the patches, {meshed - start:.0f} + {spent - meshed:.0f} CPU-s",
        flush=True,
    )  # fmt: skip
    table(ours.pads, gel_pads(theirs), phases(grasp.motion))


def as_sample(truth: dict[str, Any], theirs: Recording) -> tuple[SampleFruit, MarkerSensor]:
    """The body of `truth.json`, and the sensor of its pads."""
    axes, centre, half = (tuple(truth[k]) for k in ("axes", "pit_centre", "pit"))
    formula = FormulaSkin(half_axes_mm=axes, **{k: truth[k] for k in ("suture", "stem", "lop")})
    skin = cast(Skin, formula)  # all that meshing asks of a skin
    pit = SamplePit(centre_mm=centre, semi_axes_mm=half)
    fruit = SampleFruit(
        fruit_id=theirs.fruit_id, seed=0, skin=skin, pit=pit, E_MPa=truth["E"], poisson_ratio=truth["nu"],
        ripeness=0.5,
    )  # fmt: skip
    gel = Gel(kn_MPa_per_mm=truth["kn"], kt_MPa_per_mm=truth["kt"], friction=truth["friction"])
    places = np.unique(gel_pads(theirs)[0].rest_mm[:, 0])
    return fruit, MarkerSensor(gel=gel, markers=len(places), pitch_mm=float(places[1] - places[0]))


def as_recorded(theirs: Recording) -> PlannedGrasp:
    """The way of the pads, read from their poses; a corner at first touch comes before the first press."""
    poses = [p.pose for p in theirs.pads]
    turns = (poses[0][0, :3, :3], poses[1][0, :3, :3])
    ways = [(p[:, :3, 3] - p[0, :3, 3]) @ p[0, :3, :3] for p in poses]
    if np.abs(ways[0][:, 2] - ways[1][:, 2]).max() > 1e-9 or np.abs(ways[1][:, :2]).max() > 1e-9:
        raise SystemExit("the pads do not close alike, or the right one shears: expected neither")
    touch = np.stack([p[0, :3, 3] + CLEARANCE_MM * p[0, :3, 2] for p in poses])
    first = int(np.argmax(ways[0][:, 2] > 0))
    time_s, travel, shear = theirs.time_s, ways[0][:, 2] - CLEARANCE_MM, ways[0][:, 0]
    motion = Motion(
        time_s=np.insert(time_s, first, time_s[first - 1] + 0.1),
        travel_mm=np.insert(travel, first, 0.0),
        shear_mm=np.insert(shear, first, 0.0),
        recorded=np.insert(np.ones(len(time_s), dtype=bool), first, False),
    )
    return PlannedGrasp(
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


def gel_pads(theirs: Recording) -> list[GelPad]:
    """Its pads with markers."""
    return [p for p in theirs.pads if isinstance(p, GelPad)]


def table(
    ours: tuple[PadTruth, PadTruth],
    theirs: list[GelPad],
    phase: dict[str, Bool[np.ndarray, " t"]],
) -> None:
    """One line for each phase and pad."""
    print("  phase   pad    normal tangent   all um  marker N %   total force % (rms, peak)  shear force %")
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
                f"{rms(relative[heavy, 2]):8.3f} {relative[top, 2]:8.3f} {rms(relative[heavy, :2]):8.3f}",
                flush=True,
            )  # fmt: skip


def rms(x: Float[np.ndarray, "*n"]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(x)))) if np.size(x) else float("nan")


if __name__ == "__main__":
    run(main)
