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

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.fruit_modulus import infer_modulus
from fem.estimation.grasp_model import GraspModel, grasp_model
from fem.estimation.prepared_grasp import prepared_grasp
from fem.fem_failure import FemFailure
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes
from pipeline.fruit.placed_grasp import grasp_case, place_grasp
from recon.surface.mesh_file import read_mesh


def run_case(folder: Path, truth: dict[str, object], *, edge_mm: float, pad_edge_mm: float | None) -> None:
    """One table row per grasp."""
    case = tomllib.loads((folder / "case.toml").read_text())
    outer, pit = read_mesh(folder / "fruit.ply"), read_mesh(folder / "pit.ply")
    files = sorted(folder.glob("grasp-*.h5"))
    grasps = [place_grasp(file, *outer) for file in files]
    touched = np.vstack([points for grasp in grasps for points in grasp.touched_mm.values()])
    start = time.process_time()
    mesh = tetrahedralise(*outer, *pit, edge_mm=edge_mm, refine_at_mm=touched, refine_edge_mm=pad_edge_mm)
    meshed = time.process_time()
    true = float(truth["E_MPa"])  # type: ignore[arg-type]
    print(f"{folder.name}  {truth['effect']}  true E {true:.4f} MPa  {3 * len(mesh.nodes_mm)} dofs")
    histories = [prepared_grasp(one.history, one.turns).history for one in map(grasp_case, grasps)]

    def respond(moved: FleshMesh) -> list[GraspModel]:
        solid = UnitModulusSolid.factorise(
            moved,
            poisson_ratio=case["poisson_ratio"],
            support="free",
            contact_nodes=contact_nodes(moved, histories),
        )
        return [grasp_model(one, solid) for one in histories]

    budget = ErrorBudget(
        pit_offset_sd_mm=case["offset_sd_mm"], pit_size_sd=case["size_sd"], surface_sd_mm=case["mesh_sd_mm"]
    )
    found = infer_modulus(histories, mesh, respond, budget=budget)
    for grasp, e in zip(grasps, found.grasps, strict=True):
        if isinstance(e, FemFailure):
            print(f"  {grasp.name}  {e.detail}")
            continue
        energy = f"{e.energy.E_MPa / true:7.4f}" if e.energy else "      -"
        print(
            f"  {grasp.name}  energy/true {energy}  least squares/true {e.E_MPa / true:7.4f}  "
            f"sd {100 * e.E_sd_MPa / e.E_MPa:4.2f} %  residual {1e3 * e.residual_rms_mm:6.2f} um  "
            f"elements {100 * e.discretisation:.2f} %"
        )
        for warning in e.warnings:
            print(f"      {warning.sentence}")
    fruit = found.modulus
    parts = ", ".join(f"{name} {100 * sd / fruit.E_MPa:.2f}" for name, sd in fruit.parts_sd_MPa.items())
    print(
        f"  all      E/true {fruit.E_MPa / true:.4f}  sd {100 * fruit.E_sd_MPa / fruit.E_MPa:.2f} % ({parts})"
    )
    if fruit.pit is not None:
        offset = ", ".join(
            f"{x:+.2f} +- {sd:.2f}" for x, sd in zip(fruit.pit.offset_mm, fruit.pit.sd, strict=False)
        )
        print(f"  pit      offset {offset} mm, ln size {fruit.pit.ln_size:+.3f} +- {fruit.pit.sd[3]:.3f}")
    seconds = time.process_time()
    print(f"  CPU: mesh {meshed - start:.1f} s, the rest {seconds - meshed:.1f} s", flush=True)


def main() -> None:
    """Every case of the folder, or those named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--edge", type=float, default=5.0)
    parser.add_argument("--pad-edge", type=float)
    args = parser.parse_args()
    answers = json.loads((args.folder / "answers.json").read_text())
    for name in args.cases or sorted(answers):
        run_case(args.folder / name, answers[name], edge_mm=args.edge, pad_edge_mm=args.pad_edge)


if __name__ == "__main__":
    main()
