"""Print the modulus of ready-mesh cases, grasp by grasp, against their answers.

    python benchmarks/modulus_cases.py FOLDER [CASE ...] [--edge MM] [--pad-edge MM]

FOLDER holds one folder per case (fruit.ply, pit.ply, case.toml, grasp-N.h5) and answers.json.
"""

import argparse
import json
import time
import tomllib
from pathlib import Path

import numpy as np

from fem.forward import UnitModulusSolid
from fem.mesh import tetrahedralise
from fem.modulus import estimate_modulus
from fem.modulus_budget import ErrorBudget
from fem.modulus_combine import combine_grasps
from pipeline.grasp import history, place_grasp
from recon.mesh_file import read_mesh


def run_case(folder: Path, truth: dict[str, object], *, edge_mm: float, pad_edge_mm: float) -> None:
    """One table row per grasp."""
    case = tomllib.loads((folder / "case.toml").read_text())
    outer, pit = read_mesh(folder / "fruit.ply"), read_mesh(folder / "pit.ply")
    files = sorted(folder.glob("grasp-*.h5"))
    grasps = [place_grasp(file, *outer) for file in files]
    touched = np.vstack([points for grasp in grasps for points in grasp.touched_mm.values()])
    start = time.perf_counter()
    mesh = tetrahedralise(*outer, *pit, edge_mm=edge_mm, refine_at_mm=touched, refine_edge_mm=pad_edge_mm)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=case["poisson_ratio"], support="free")
    seconds = time.perf_counter() - start
    true = float(truth["E_MPa"])  # type: ignore[arg-type]
    print(
        f"{folder.name}  {truth['effect']}  true E {true:.4f} MPa  {3 * len(mesh.nodes_mm)} dofs  "
        f"mesh and factor {seconds:.1f} s"
    )
    budget = ErrorBudget(
        pit_offset_sd_mm=case["offset_sd_mm"], pit_size_sd=case["size_sd"], surface_sd_mm=case["mesh_sd_mm"]
    )
    estimates = []
    for grasp in grasps:
        start = time.perf_counter()
        e = estimate_modulus(history(grasp), solid, budget=budget)
        energy = f"{e.energy.E_MPa / true:7.4f}" if e.energy else "      -"
        print(
            f"  {grasp.name}  energy/true {energy}  least squares/true {e.E_MPa / true:7.4f}  "
            f"sd {100 * e.E_sd_MPa / e.E_MPa:4.2f} %  residual {1e3 * e.residual_rms_mm:6.2f} um  "
            f"registration {max(p.residual_mm for p in grasp.pads):.3f} mm  "
            f"{time.perf_counter() - start:4.1f} s",
            flush=True,
        )
        for sentence in e.warnings:
            print(f"      {sentence}")
        estimates.append(e)
    fruit = combine_grasps(estimates)
    print(
        f"  all      E/true {fruit.E_MPa / true:.4f}  sd {100 * fruit.E_sd_MPa / fruit.E_MPa:.2f} %",
        flush=True,
    )


def main() -> None:
    """Every case of the folder, or those named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--edge", type=float, default=6.0)
    parser.add_argument("--pad-edge", type=float, default=2.0)
    args = parser.parse_args()
    answers = json.loads((args.folder / "answers.json").read_text())
    for name in args.cases or sorted(answers):
        run_case(args.folder / name, answers[name], edge_mm=args.edge, pad_edge_mm=args.pad_edge)


if __name__ == "__main__":
    main()
