"""What the truth generator of mismatch cases leaves: one grasp of a soft and a firm fruit on several meshes.

    python benchmarks/truth_convergence.py [--moduli 0.2 1.0] [--law linear | neo-hookean]

For each fruit a table: unknowns, CPU-s, and at the end of the largest load the markers' displacement (um, rms
and largest component over touched markers, both pads) and the pads' force (percent) against the finest mesh;
then the gel points and the steps in time of the default. The last line of a fruit of linear flesh
extrapolates the error of the default mesh to bricks of no size, with the order that the meshes of 4, 5 and 7
bricks along a cube side show. Neo-Hookean flesh is sheared under the load, so that the fruit turns; it is
held against bricks of 5 along a side, and computed with rounds that stop ten times earlier as well.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from samples.mismatch.bodies import ElasticBody
from samples.mismatch.drawn_fruit import DrawnFruit, drawn_fruit
from samples.mismatch.four_grasps import CaseGrasp, four_grasps
from samples.mismatch.meshed_fruit import CASE, EVEN, NONLINEAR_CASE, meshed_fruit
from samples.mismatch.nonlinear_body import CONVERGED_MM
from samples.mismatch.nulls import LAWS, neo_hookean_body
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of

FINEST = replace(CASE, cells=7)
MESHES = {
    "finest (7 along a side)": FINEST, "even, 3.3 mm (earlier cases)": EVEN,
    "nonlinear flesh (4 along)": NONLINEAR_CASE, "default (5 along)": CASE,
}  # fmt: skip

NEARLY = 0.97
"""Share of the largest load that counts as it: shear takes a hundredth of it away."""


def main() -> None:
    """Print both fruits' tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--moduli", type=float, nargs="+", default=[0.2, 1.0], help="MPa")
    parser.add_argument("--law", choices=LAWS, default=LAWS[0])
    asked = parser.parse_args()
    for modulus in asked.moduli:
        rng = np.random.default_rng(5)
        drawn = drawn_fruit("truth", category="plum", rng=rng)
        drawn = replace(drawn, fruit=replace(drawn.fruit, E_MPa=modulus))
        grasps = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)
        print(f"plum, E {modulus} MPa, {asked.law}: unknowns, CPU-s, um rms, um largest, force %", flush=True)
        if asked.law == LAWS[0]:
            linear_table(drawn, grasps[1])
        else:
            sheared_table(drawn, grasps[2])


def linear_table(drawn: DrawnFruit, grasp: CaseGrasp) -> None:
    """One fruit of linear flesh."""
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


def sheared_table(drawn: DrawnFruit, grasp: CaseGrasp) -> None:
    """One fruit of Neo-Hookean flesh."""
    truth = None
    early_mm = 10 * CONVERGED_MM
    ways = {
        "5 along": (CASE, CONVERGED_MM, 1),
        "nonlinear flesh (4 along)": (NONLINEAR_CASE, CONVERGED_MM, 1),
        f"4 along, rounds to {early_mm:.0e} mm": (NONLINEAR_CASE, early_mm, 1),
        "4 along, two steps": (NONLINEAR_CASE, CONVERGED_MM, 2),
    }
    for name, (fineness, stop_mm, steps) in ways.items():
        start = time.process_time()
        stands = meshed_fruit(drawn, grasp, fineness=fineness)
        body = neo_hookean_body(stands, stop_mm=stop_mm)
        found = grasped(grasp, grip_of(stands, gel=drawn.sensor.gel), body, steps=steps)
        spent = time.process_time() - start
        truth = found if truth is None else truth
        line(f"{name:30s} {stands.flesh.unknowns:7d} {spent:5.0f}", differences(found, truth))


def line(name: str, found: tuple[float, float, float]) -> None:
    """One row."""
    print(f"  {name:46s} {found[0]:7.3f} {found[1]:7.2f} {found[2]:8.4f}", flush=True)


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


def extrapolated(sizes: dict[str, tuple[float, float, float]]) -> float:
    """Error e = c h^p of the default from e(h) - e(h finest): p where the coarser mesh has the same c."""
    rough, default = (sizes[name][0] for name in list(MESHES)[2:])
    orders = np.linspace(0.5, 6.0, 221)
    misfit = [rough / (4.0**-p - 7.0**-p) - default / (5.0**-p - 7.0**-p) for p in orders]
    p = float(orders[int(np.argmin(np.abs(misfit)))])
    return float(default / (5.0**-p - 7.0**-p) * 5.0**-p)


if __name__ == "__main__":
    main()
