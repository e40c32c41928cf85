"""What the simulator of mismatch cases leaves: one grasp with a shear leg of a soft and a firm fruit.

    python benchmarks/truth_convergence.py [--moduli 0.2 1.0]

For each fruit a table: unknowns, CPU-s, and at the end of the largest load the markers' displacement (um, rms
and largest component over touched markers, both pads) and the pads' force (percent) against the finest mesh;
then the default against itself with other gel points, with more steps in time and with rounds that stop ten
times earlier.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from samples.graded_bricks import BrickGrading
from samples.mismatch.case_simulation import sound_body
from samples.mismatch.drawn_fruit import DrawnFruit, drawn_fruit
from samples.mismatch.four_grasps import CaseGrasp, four_grasps
from samples.mismatch.gel_bed import POINTS
from samples.mismatch.meshed_fruit import CASE, meshed_fruit
from samples.mismatch.nonlinear_body import CONVERGED_MM
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of

MESHES = {
    "5 along a side, 5 layers": replace(CASE, cells=5, layers=5),
    "4 along, 4 layers, slower growth": replace(CASE, growth=0.5),
    "4 along, 2 layers": replace(CASE, layers=2),
    "3 along, 3 layers": replace(CASE, cells=3, layers=3),
}
"""The finest first, then what each differs by from the default (4 along a side, 4 layers)."""
NEARLY = 0.97
"""Share of the largest load that counts as it: shear takes a hundredth of it away."""


def main() -> None:
    """Print both fruits' tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--moduli", type=float, nargs="+", default=[0.2, 1.0], help="MPa")
    asked = parser.parse_args()
    for modulus in asked.moduli:
        rng = np.random.default_rng(5)
        drawn = drawn_fruit("truth", category="plum", rng=rng)
        drawn = replace(drawn, fruit=replace(drawn.fruit, E_MPa=modulus))
        grasp = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)[2]
        print(f"plum, E {modulus} MPa: unknowns, CPU-s, um rms, um largest, force %", flush=True)
        finest = None
        for name, mesh in MESHES.items():
            found = run(name, drawn, grasp, finest, mesh=mesh)
            finest = found if finest is None else finest
        default = run("default", drawn, grasp, finest)
        run("default, 3 x 3 gel points", drawn, grasp, default, points=3)
        run("default, two steps from frame to frame", drawn, grasp, default, steps=2)
        early_mm = 10 * CONVERGED_MM
        run(f"default, rounds to {early_mm:.0e} mm", drawn, grasp, default, stop_mm=early_mm)


def run(
    name: str, drawn: DrawnFruit, grasp: CaseGrasp, reference: TrueRecording | None, *,
    mesh: BrickGrading = CASE, points: int = POINTS, steps: int = 1, stop_mm: float = CONVERGED_MM,
) -> TrueRecording:  # fmt: skip
    """Simulate in one way and print its row."""
    start = time.process_time()
    stands = meshed_fruit(drawn, grasp, fineness=mesh)
    body = sound_body(stands, stop_mm=stop_mm)
    found = grasped(grasp, grip_of(stands, gel=drawn.sensor.gel, points=points), body, steps=steps)
    spent = time.process_time() - start
    away = differences(found, found if reference is None else reference)
    print(
        f"  {name:40s} {stands.flesh.unknowns:7d} {spent:5.0f} {away[0]:7.3f} {away[1]:7.2f} {away[2]:8.4f}",
        flush=True,
    )
    return found


def differences(truth: TrueRecording, reference: TrueRecording) -> tuple[float, float, float]:
    """Markers' displacement, um rms and largest, and the pads' largest difference of force, percent."""
    moved, force = [], []
    for one, other in zip(truth.pads, reference.pads, strict=True):
        load = other.force_N[..., 2].sum(axis=1)
        at = int(np.flatnonzero(load > NEARLY * load.max())[-1])
        touched = other.force_N[at, :, 2] > 0
        moved.append(1e3 * (one.displacement_mm[at] - other.displacement_mm[at])[touched])
        force.append(100 * (one.force_N[at, :, 2].sum() / other.force_N[at, :, 2].sum() - 1))
    away = np.concatenate(moved)
    return float(np.sqrt((away**2).mean())), float(np.abs(away).max()), float(max(force, key=abs))


if __name__ == "__main__":
    main()
