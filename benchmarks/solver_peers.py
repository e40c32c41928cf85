"""Assembly, factorisation and solves of fem against its peers, on the same meshes, in one run.

    python benchmarks/solver_peers.py --peers-python <environment>/bin/python

prints one table per size, the ratios to the fastest peer, and what the compliance of all candidate contact
dofs costs; benchmarks/results/solver_peers.csv keeps them. Everything is single-threaded, every solver has a
process of its own; CPU seconds and peak memory are the process's.

The problem: a nectarine's flesh, finer at eight contact patches, straight T10, E = 1 MPa, nu = 0.45, all
nodes of the pit held; a hundred loads, the first a uniform body force, the others random forces on all free
nodes. Displacements under the first are compared.

Peers are measured where they are installed, and named where not. An environment that has them all, on Debian:

    apt-get install libsuitesparse-dev libopenblas-dev calculix-ccx
    python -m venv peers && peers/bin/pip install numpy scipy felupe pypardiso scikit-fem ngsolve \
        "scikit-sparse<0.5"

(scikit-sparse 0.5 wants a newer SuiteSparse than Debian 12's.)
"""

import argparse
import csv
import importlib.util
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from solver_candidates import CANDIDATE_NODES, LOADS, PEERS, PHASES, Clock

CPU_LIMIT_S = 100
#: solvers that take longer than this are run once only
PATIENCE_S = 18
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NGS_NUM_THREADS"), "1"
)
COLUMNS = ["size", "dofs", "solver", *PHASES, "total", "ratio", "process", "peak_MB", "off", "note"]
#: for each size: edges away from the patches, at the patches (mm), the patches' radius (mm), limit of dofs
SIZES = {"20k": (6.0, 3.5, 3.0, 20_000), "60k": (5.0, 1.5, 4.5, 60_000), "150k": (3.2, 1.2, 4.5, 150_000)}


def build(path: Path, size: str) -> int:
    """Mesh, loads and candidate contact nodes of one size, kept in a file that all solvers read."""
    from fem.elements.assembly import lumped_moments
    from fem.elements.shape_functions import TET_EDGES
    from fem.mesh.flesh_mesh import tetrahedralise

    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
    from fem_shapes import ball

    axes = np.array([30.5, 29.5, 28.5])
    turn = np.pi * np.arange(4) / 4 + 0.1
    way = np.stack([np.cos(turn), np.sin(turn), 0.2 * (-1.0) ** np.arange(4)], axis=1)
    patches = np.concatenate([way, -way])
    patches /= np.linalg.norm(patches / axes, axis=1, keepdims=True)
    edge_mm, patch_edge_mm, radius_mm, limit = SIZES[size]
    mesh = tetrahedralise(
        *ball(4000, semi_axes_mm=axes),
        *ball(2000, semi_axes_mm=(15, 10, 12.5), centre_mm=(0.5, -0.4, 0.8)),
        edge_mm=edge_mm,
        refine_at_mm=patches,
        refine_radius_mm=radius_mm,
        refine_edge_mm=patch_edge_mm,
        dof_limit=limit,
    )
    nodes, n_corners = mesh.nodes_mm.copy(), mesh.tets[:, :4].max() + 1
    nodes[mesh.tets[:, 4:]] = nodes[mesh.tets[:, TET_EDGES]].mean(axis=2)
    faces = np.concatenate([mesh.tets[:, k] for k in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3])])
    _, which, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    border = faces[which[count == 1]]
    on_pit = np.isin(border, mesh.pit_nodes).all(axis=1)
    held = np.zeros(len(nodes), dtype=bool)
    held[mesh.pit_nodes] = True
    free = np.flatnonzero(np.repeat(~held, 3))
    load = np.random.default_rng(0).standard_normal((len(free), LOADS))
    body = np.zeros((len(nodes), 3))
    body[:, 2] = lumped_moments(nodes, mesh.tets)[:, 0]
    load[:, 0] = body.reshape(-1)[free]
    skin = mesh.outer_nodes
    apart = np.linalg.norm(nodes[skin][:, None] - patches, axis=2).min(axis=1)
    candidates = np.sort(skin[np.argsort(apart)[:CANDIDATE_NODES]])
    assert border.max() < n_corners
    np.savez(
        path, nodes=nodes, tets=mesh.tets, skin=border[~on_pit], pit=border[on_pit], free=free, load=load,
        candidates=candidates,
    )  # fmt: skip
    return len(free)


def run_one(name: str, case_path: Path, out_path: Path) -> None:
    """In a process of its own: solve, and keep phases and displacement."""
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
    function, needed = PEERS[name]
    missing = [module for module in needed if importlib.util.find_spec(module) is None]
    if missing or (name == "CalculiX" and shutil.which("ccx") is None):
        np.savez(out_path, missing=", ".join(missing) or "ccx")
        return
    with np.load(case_path) as stored:
        case = dict(stored)
    clock = Clock()
    moved = function(case, clock)
    np.savez(out_path, moved=moved, **clock.spent)


def measure(name: str, python: str, case: Path, folder: Path) -> dict:
    """Run one solver; its phases, whole CPU seconds and peak memory."""
    out = folder / "out.npz"
    out.unlink(missing_ok=True)
    environment = {**os.environ, **ONE_THREAD}
    process = subprocess.Popen(
        [python, __file__, "--run", name, str(case), str(out)], env=environment, stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if not out.exists():
        return {"note": f"ended with {process.returncode} after {usage.ru_utime:.0f} CPU s"}
    with np.load(out) as stored:
        found = dict(stored)
    if "missing" in found:
        return {"note": f"not installed: {found['missing']}"}
    phases = {phase: float(found[phase]) for phase in PHASES}
    whole = usage.ru_utime + usage.ru_stime
    return {"moved": found["moved"], **phases, "process": whole, "peak_MB": usage.ru_maxrss / 1024}


def total(row: dict) -> float:
    """Assembly, factorisation (with ordering) and a hundred solves."""
    return row["assembly"] + row["factor"] + row["hundred_solves"]


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peers-python", default=sys.executable)
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), choices=list(SIZES))
    parser.add_argument(
        "--repeats", type=int, default=1, help="of several runs the one with the least total counts"
    )
    parser.add_argument("--run", nargs=3, metavar=("SOLVER", "CASE", "OUT"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        run_one(options.run[0], Path(options.run[1]), Path(options.run[2]))
        return
    rows = []
    target = Path(__file__).parent / "results" / "solver_peers.csv"
    target.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for size in options.sizes:
            case = Path(folder, f"{size}.npz")
            dofs = build(case, size)
            rows += compare(size, dofs, case, Path(folder), options)
            with target.open("w", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
                writer.writeheader()
                writer.writerows(
                    {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows
                )


def compare(size: str, dofs: int, case: Path, folder: Path, options: argparse.Namespace) -> list[dict]:
    """All solvers on one mesh, in turn; printed as they come."""
    print(f"\n{size}: {dofs} dofs (CPU s, one thread)")
    print(f"{'':24}assembly  factor  1 solve  100 solves   total  process  peak MB  off")
    rows: list[dict] = []
    for name in PEERS:
        python = sys.executable if name.startswith("drupe") else options.peers_python
        tries = [measure(name, python, case, folder)]
        while len(tries) < options.repeats and tries[0].get("process", np.inf) < PATIENCE_S:
            tries.append(measure(name, python, case, folder))
        row = {"size": size, "dofs": dofs, "solver": name}
        if "moved" not in tries[0]:
            row |= tries[0]
            print(f"{name:24}{row['note']}", flush=True)
        else:
            row |= min(tries, key=total)
            reference = rows[0]["moved"] if rows else row["moved"]
            row["off"] = float(np.nanmax(np.abs(row["moved"] - reference)) / np.abs(reference).max())
            row["total"] = float("nan") if name == "CalculiX" else total(row)
            print(
                f"{name:24}{row['assembly']:8.2f}{row['factor']:8.2f}{row['one_solve']:9.3f}"
                f"{row['hundred_solves']:12.2f}{row['total']:8.2f}{row['process']:9.2f}{row['peak_MB']:9.0f}"
                f"  {row['off']:.0e}",
                flush=True,
            )
        rows.append(row)
    totals = {row["solver"]: row["total"] for row in rows[2:] if row.get("total", np.nan) > 0}
    if totals and "total" in rows[0]:
        best = min(totals, key=totals.__getitem__)
        rows[0]["ratio"] = rows[0]["total"] / totals[best]
        print(f"drupe takes {rows[0]['ratio']:.2f} times the CPU time of the fastest peer, {best}")
    if "total" in rows[0] and "total" in rows[1]:
        spent, plain = rows[1]["hundred_solves"], rows[0]["hundred_solves"] / LOADS
        rows[1]["ratio"] = spent / rows[0]["factor"]
        print(
            f"the compliance of {3 * CANDIDATE_NODES} dofs takes {rows[1]['ratio']:.2f} times the "
            f"factorisation, {spent:.2f} s; as plain solves {plain * 3 * CANDIDATE_NODES:.0f} s"
        )
    return rows


if __name__ == "__main__":
    main()
