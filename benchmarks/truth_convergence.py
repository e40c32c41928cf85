"""What the truth generator of mismatch cases leaves: one grasp of a soft and a firm fruit on several meshes.

    python benchmarks/truth_convergence.py [--moduli 0.2 1.0]

For each fruit a table: unknowns, CPU-s, and at the largest load the markers' displacement (um, rms and
largest component over touched markers, both pads) and the pads' force (percent) against the finest mesh; then
the gel points and the steps in time of the default. The last line of a fruit extrapolates the error of the
default mesh to bricks of no size, with the order that the meshes of 4, 5 and 7 bricks along a cube side show.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from samples.mismatch.bodies import ElasticBody
from samples.mismatch.drawn_fruit import DrawnFruit, drawn_fruit
from samples.mismatch.four_grasps import CaseGrasp, four_grasps
from samples.mismatch.meshed_fruit import CASE, EVEN, NONLINEAR_CASE, meshed_fruit
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of

FINEST = replace(CASE, cells=7)
MESHES = {
    "finest (7 along a side)": FINEST, "even, 3.3 mm (earlier cases)": EVEN,
    "nonlinear flesh (4 along)": NONLINEAR_CASE, "default (5 along)": CASE,
}  # fmt: skip


def main() -> None:
    """Print both fruits' tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--moduli", type=float, nargs="+", default=[0.2, 1.0], help="MPa")
    for modulus in parser.parse_args().moduli:
        rng = np.random.default_rng(5)
        drawn = drawn_fruit("truth", category="plum", rng=rng)
        drawn = replace(drawn, fruit=replace(drawn.fruit, E_MPa=modulus))
        table(drawn, four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)[1])


def table(drawn: DrawnFruit, grasp: CaseGrasp) -> None:
    """One fruit."""
    print(f"plum, E {drawn.fruit.E_MPa} MPa: unknowns, CPU-s, um rms, um largest, force %", flush=True)
    reference = None
    sizes = {}
    for name, fineness in MESHES.items():
        start = time.process_time()
        stands = meshed_fruit(drawn, grasp, fineness=fineness)
        compliance = skin_compliance(stands.flesh.stiffness, stands.dofs)
        truth = grasped(grasp, grip_of(stands, gel=drawn.sensor.gel), ElasticBody(compliance))
        spent = time.process_time() - start
        reference = truth if reference is None else reference
        sizes[name] = differences(truth, reference)
        line(f"{name:30s} {stands.flesh.unknowns:7d} {spent:5.0f}", sizes[name])
    for points, steps in ((3, 1), (6, 1), (4, 2)):
        grip = grip_of(stands, gel=drawn.sensor.gel, points=points)
        other = grasped(grasp, grip, ElasticBody(compliance), steps=steps)
        line(f"default, {points}x{points} gel points, {steps} step(s)", differences(other, truth))
    print(f"default, extrapolated: {extrapolated(sizes):.2f} um rms", flush=True)


def line(name: str, found: tuple[float, float, float]) -> None:
    """One row."""
    print(f"  {name:46s} {found[0]:7.3f} {found[1]:7.2f} {found[2]:8.4f}", flush=True)


def differences(truth: TrueRecording, reference: TrueRecording) -> tuple[float, float, float]:
    """Markers' displacement, um rms and largest, and the pads' largest difference of force, percent."""
    moved, force = [], []
    for one, other in zip(truth.pads, reference.pads, strict=True):
        at = int(other.force_N[..., 2].sum(axis=1).argmax())
        touched = other.force_N[at, :, 2] > 0
        moved.append(1e3 * (one.displacement_mm[at] - other.displacement_mm[at])[touched])
        force.append(100 * (one.force_N[at, :, 2].sum() / other.force_N[at, :, 2].sum() - 1))
    away = np.concatenate(moved)
    return float(np.sqrt((away**2).mean())), float(np.abs(away).max()), float(max(force, key=abs))


def extrapolated(sizes: dict[str, tuple[float, float, float]]) -> float:
    """Error e = c h^p of the default from e(h) - e(h finest): p where the coarser mesh has the same c."""
    rough, default = (sizes[name][0] for name in list(MESHES)[2:])
    orders = np.linspace(0.5, 6.0, 221)
    misfit = [rough / (4.0**-p - 7.0**-p) - default / (5.0**-p - 7.0**-p) for p in orders]
    p = float(orders[int(np.argmin(np.abs(misfit)))])
    return float(default / (5.0**-p - 7.0**-p) * 5.0**-p)


if __name__ == "__main__":
    main()
