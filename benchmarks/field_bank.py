"""Draws sound fruit for field_mistakes.py: ready meshes and recordings whose contact a solver has found.

    python benchmarks/field_bank.py FOLDER --first 0 --count 100 [--grasps 2]

FOLDER/NNN holds fruit.ply (scanned with 0.1 mm of error), pit.ply of what is no nectarine, grasp-1.h5, ...
and truth.json. Of five fruit three are nectarines, one a plum, one a ball of silicone with a core; E is
log-uniform in 0.15 to 1.5 MPa, Neo-Hookean; azimuth, tilt, travel and speed of each grasp are drawn. Elements
are coarser than those of the shipped sample (about 45 s of processor time a grasp): the recordings test what
the checks say of them, not E to a per cent. A folder that has its truth.json is left as it is.
"""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from script import run

from recon.surface.mesh_file import write_mesh
from samples.cubed_sphere import even_sphere
from samples.fruit import SampleFruit, SamplePit, fruit_of_seed, scanned_mesh, scanned_skin
from samples.grasp_plan import PlannedGrasp, hold_along, two_cycles
from samples.hexahedra import Fineness
from samples.mismatch.drawn_fruit import Category, drawn_fruit
from samples.sample_batch import simulate
from samples.sample_failure import SampleFailure
from tactile.readers.recording import Recording, write_recording

FINENESS = Fineness(degrees=(0, 5, 10, 15, 28, 45), along=3, depths=(0, 0.2, 0.5, 1))
KINDS: tuple[Category, ...] = ("nectarine", "plum", "nectarine", "nectarine", "pdms_ball")
MESH_CELLS, MESH_ERROR_MM, PIT_CELLS = 28, 0.1, 12
TRIES = 3


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A fruit, its scanned mesh, the pit that is given with it (None: the category's) and its travel (mm)."""

    fruit: SampleFruit
    category: str
    mesh: tuple[np.ndarray, np.ndarray]
    given_pit: SamplePit | None
    depth_mm: float

    @property
    def pit_mesh(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Vertices and triangles of the pit that is given."""
        sphere, pit = even_sphere(PIT_CELLS), self.given_pit
        return None if pit is None else (pit.points_mm(sphere.directions), sphere.triangles())


def drawn(number: int, rng: np.random.Generator) -> Drawn:
    """The fruit of a number; always the same."""
    name, kind = f"F{number:03d}", KINDS[number % len(KINDS)]
    E_MPa = float(np.exp(rng.uniform(np.log(0.15), np.log(1.5))))
    if kind == "nectarine":
        fruit = fruit_of_seed(name, seed=5000 + number, E_MPa=E_MPa)
        mesh = scanned_mesh(fruit, cells=MESH_CELLS, error_mm=MESH_ERROR_MM)
        return Drawn(fruit=fruit, category="nectarine", mesh=mesh, given_pit=None, depth_mm=1.5)
    drawn_sample = drawn_fruit(name, category=kind, rng=rng)
    return Drawn(
        fruit=replace(drawn_sample.fruit, E_MPa=E_MPa, seed=5000 + number),
        category={"pdms_ball": "phantom"}.get(kind, kind),
        mesh=scanned_skin(drawn_sample.fruit.skin, cells=MESH_CELLS, error_mm=MESH_ERROR_MM, rng=rng),
        given_pit=drawn_sample.prior,
        depth_mm=min(1.5, drawn_sample.depth_mm),
    )


def grasped(drawing: Drawn, azimuth_deg: float, grasp: int, rng: np.random.Generator) -> Recording | None:
    """One grasp, less deep where the solver does not get there; None where it never does."""
    depth_mm = drawing.depth_mm
    for _ in range(TRIES):
        hold = hold_along(
            drawing.fruit, azimuth_deg=azimuth_deg + rng.normal(0, 8), tilt_deg=float(rng.normal(0, 4))
        )
        way = two_cycles(
            deepest_mm=depth_mm * float(rng.uniform(0.8, 1)), speed_mm_per_s=float(rng.uniform(0.6, 3))
        )
        try:
            noise_rng = np.random.default_rng([drawing.fruit.seed, 7, grasp])
            plan = PlannedGrasp(name=f"grasp-{grasp + 1}", hold=hold, motion=way)
            recording = simulate(drawing.fruit, plan, rng=noise_rng, fineness=FINENESS)
        except SampleFailure as failure:
            sys.stderr.write(f"{drawing.fruit.fruit_id} grasp {grasp + 1}: {failure}; less deep\n")
            depth_mm *= 0.8
            continue
        return replace(recording, category=drawing.category)
    return None


def write_fruit(number: int, folder: Path, grasps: int) -> None:
    """FOLDER/NNN, unless it is there already; none where a grasp cannot be simulated."""
    out = folder / f"{number:03d}"
    if (out / "truth.json").exists():
        return
    rng = np.random.default_rng([77, number])
    drawing = drawn(number, rng)
    first_deg = rng.uniform(30, 60)
    recordings = [grasped(drawing, first_deg + 90 * g, g, rng) for g in range(grasps)]
    if any(recording is None for recording in recordings):
        sys.stderr.write(f"{drawing.fruit.fruit_id}: left out\n")
        return
    out.mkdir(parents=True, exist_ok=True)
    for k, recording in enumerate(recordings):
        if recording is not None:
            write_recording(out / f"grasp-{k + 1}.h5", recording)
    write_mesh(out / "fruit.ply", *drawing.mesh)
    if drawing.pit_mesh is not None:
        write_mesh(out / "pit.ply", *drawing.pit_mesh)
    truth = {"E_MPa": drawing.fruit.E_MPa, "fruit_id": drawing.fruit.fruit_id, "category": drawing.category}
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def main(folder: Path, first: int = 0, count: int = 100, grasps: int = 2) -> None:
    """Writes the fruit, one after the other."""
    for number in range(first, first + count):
        write_fruit(number, folder, grasps)
        print(f"{number:03d}", flush=True)


if __name__ == "__main__":
    run(main)
