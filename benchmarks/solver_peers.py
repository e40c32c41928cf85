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
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np

NU, LOADS, CPU_LIMIT_S = 0.45, 100, 100
#: solvers that take longer than this are run once only
PATIENCE_S = 18
PHASES = ("assembly", "factor", "one_solve", "hundred_solves")
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NGS_NUM_THREADS"), "1"
)
COLUMNS = ["size", "dofs", "solver", *PHASES, "total", "ratio", "process", "peak_MB", "off", "note"]
#: for each size: edges away from the patches, at the patches (mm), the patches' radius (mm), limit of dofs
SIZES = {"20k": (6.0, 3.5, 3.0, 20_000), "60k": (5.0, 1.5, 4.5, 60_000), "150k": (3.2, 1.2, 4.5, 150_000)}
CANDIDATE_NODES = 1000


class Clock:
    """CPU seconds of named phases."""

    def __init__(self) -> None:
        self.spent = dict.fromkeys(PHASES, 0.0)

    @contextmanager
    def __call__(self, phase: str):
        """Time what happens inside."""
        begun = time.process_time()
        yield
        self.spent[phase] += time.process_time() - begun


def ours(case: dict, clock: Clock) -> np.ndarray:
    """The border of fem, whatever solver is behind it."""
    from fem.sparse.solver import factorise

    stiffness, _ = _our_stiffness(case, clock)
    with clock("factor"):
        factor = factorise(stiffness)
    return _solves(clock, factor.solve, case["load"])


def our_compliance(case: dict, clock: Clock) -> np.ndarray:
    """Under `hundred_solves`: the compliance of all candidates, tried on three of them."""
    from fem.sparse.solver import factorise

    stiffness, place = _our_stiffness(case, clock)
    last = place[(3 * case["candidates"][:, None] + np.arange(3)).ravel()]
    with clock("factor"):
        factor = factorise(stiffness, last=last)
    with clock("hundred_solves"):
        compliance = factor.last_compliance()
    some = [0, len(last) // 2, len(last) - 1]
    unit = np.zeros((stiffness.shape[0], 3))
    unit[last[some], np.arange(3)] = 1
    assert np.allclose(factor.solve(unit)[last], compliance[:, some], rtol=1e-9)
    return factor.solve(case["load"][:, :1])[:, 0]


def _our_stiffness(case: dict, clock: Clock):
    from scipy.sparse import csr_array

    from fem.elements.assembly import assemble
    from fem.solid.rigid_core import reduced

    n, free = 3 * len(case["nodes"]), case["free"]
    with clock("assembly"):
        whole = assemble(case["nodes"], case["tets"]).for_unit_modulus(poisson_ratio=NU)
        pick = csr_array((np.ones(len(free)), (free, np.arange(len(free)))), shape=(n, len(free)))
        stiffness = reduced(whole, pick)
    place = np.empty(n, dtype=int)
    place[free] = np.arange(len(free))
    return stiffness, place


def felupe_cholmod(case: dict, clock: Clock) -> np.ndarray:
    """Supernodal, on a METIS order."""
    from sksparse.cholmod import analyze

    stiffness = _felupe(case, clock)
    with clock("factor"):
        factor = analyze(stiffness, mode="supernodal", ordering_method="metis").cholesky(stiffness)
    return _solves(clock, factor, case["load"])


def felupe_pardiso(case: dict, clock: Clock) -> np.ndarray:
    """Symmetric positive definite, from the upper triangle."""
    from pypardiso import PyPardisoSolver
    from scipy.sparse import csr_matrix, triu

    stiffness = _felupe(case, clock)
    solver = PyPardisoSolver(mtype=2)
    with clock("factor"):
        upper = csr_matrix(triu(stiffness, format="csr"))
        upper.sort_indices()
        solver.factorize(upper)
    return _solves(clock, lambda load: solver.solve(upper, np.asfortranarray(load)), case["load"])


def skfem_scipy(case: dict, clock: Clock) -> np.ndarray:
    """Dofs are matched to nodes by place, outside the clock."""
    import skfem
    from scipy.sparse.linalg import splu
    from scipy.spatial import cKDTree
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    corners = case["tets"][:, :4].max() + 1
    with clock("assembly"):
        mesh = skfem.MeshTet(case["nodes"][:corners].T.copy(), case["tets"][:, :4].T.copy())
        basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=2)
        stiffness = linear_elasticity(*lame_parameters(1.0, NU)).assemble(basis)
    node = cKDTree(case["nodes"]).query(basis.doflocs.T)[1]
    axis = np.zeros(basis.N, dtype=int)
    for kind in (basis.nodal_dofs, basis.edge_dofs):
        for k in range(3):
            axis[kind[k]] = k
    theirs = np.empty(basis.N, dtype=int)
    theirs[3 * node + axis] = np.arange(basis.N)
    free = theirs[case["free"]]
    with clock("assembly"):
        stiffness = stiffness[free][:, free].tocsc()
    with clock("factor"):
        lu = splu(
            stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    columns = lambda load: np.stack([lu.solve(one) for one in load.T], axis=1)  # noqa: E731
    return _solves(clock, columns, case["load"])


def ngsolve(case: dict, clock: Clock) -> np.ndarray:
    """Its basis is hierarchic: random loads are random there, and the body force is its own."""
    import ngsolve as ngs
    from netgen.meshing import Element2D, Element3D, FaceDescriptor, Mesh, MeshPoint, Pnt

    mesh = Mesh()
    mesh.dim = 3
    corners = case["tets"][:, :4].max() + 1
    points = [mesh.Add(MeshPoint(Pnt(*x))) for x in case["nodes"][:corners].tolist()]
    for number, name in ((1, "skin"), (2, "pit")):
        mesh.Add(FaceDescriptor(surfnr=number, domin=1, domout=0, bc=number))
        mesh.SetBCName(number - 1, name)
        for face in case[name].tolist():
            mesh.Add(Element2D(number, [points[k] for k in face]))
    for tet in case["tets"][:, [0, 2, 1, 3]].tolist():
        mesh.Add(Element3D(1, [points[k] for k in tet]))
    mesh = ngs.Mesh(mesh)
    mu, lame = 0.5 / (1 + NU), NU / ((1 + NU) * (1 - 2 * NU))
    with clock("assembly"):
        space = ngs.VectorH1(mesh, order=2, dirichlet="pit")
        u, v = space.TnT()
        strain = lambda w: 0.5 * (ngs.Grad(w) + ngs.Grad(w).trans)  # noqa: E731
        form = ngs.BilinearForm(space, symmetric=True)
        form += (2 * mu * ngs.InnerProduct(strain(u), strain(v)) + lame * ngs.div(u) * ngs.div(v)) * ngs.dx
        form.Assemble()
        force = ngs.LinearForm(space)
        force += v[2] * ngs.dx
        force.Assemble()
    with clock("factor"):
        inverse = form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    moved = ngs.GridFunction(space)
    other = moved.vec.CreateVector()
    with clock("one_solve"):
        moved.vec.data = inverse * force.vec
    with clock("hundred_solves"):
        for _ in range(LOADS):
            other.data = inverse * force.vec
    z = moved.vec.FV().NumPy().reshape(3, -1)[:, :corners]
    out = np.full((len(case["nodes"]), 3), np.nan)
    out[:corners] = z.T
    return out.reshape(-1)[case["free"]]


def calculix(case: dict, clock: Clock) -> np.ndarray:
    """Assembly, factorisation and one solve, for it keeps no factor between loads: all under `factor`."""
    nodes, tets = case["nodes"], case["tets"] + 1
    held = np.setdiff1d(np.arange(3 * len(nodes)), case["free"])[::3] // 3 + 1
    force = np.zeros(3 * len(nodes))
    force[case["free"]] = case["load"][:, 0]
    loaded = np.flatnonzero(force)
    deck = ["*NODE, NSET=ALL", *(f"{k},{x:.12e},{y:.12e},{z:.12e}" for k, (x, y, z) in enumerate(nodes, 1))]
    deck += [
        "*ELEMENT, TYPE=C3D10, ELSET=FLESH",
        *(f"{k}," + ",".join(map(str, t)) for k, t in enumerate(tets, 1)),
    ]
    deck += ["*MATERIAL, NAME=FLESH", "*ELASTIC", f"1.,{NU}", "*SOLID SECTION, ELSET=FLESH, MATERIAL=FLESH"]
    deck += ["*BOUNDARY", *(f"{k},1,3" for k in held), "*STEP", "*STATIC, SOLVER=SPOOLES", "*CLOAD"]
    deck += [f"{k // 3 + 1},{k % 3 + 1},{force[k]:.12e}" for k in loaded.tolist()]
    deck += ["*NODE PRINT, NSET=ALL", "U", "*END STEP", ""]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "flesh.inp").write_text("\n".join(deck))
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(["ccx", "flesh"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        clock.spent["factor"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        table = np.array(
            [line.split() for line in Path(folder, "flesh.dat").read_text().split("\n")[3:] if line]
        )
    return table[np.argsort(table[:, 0].astype(int)), 1:].astype(float).reshape(-1)[case["free"]]


def _felupe(case: dict, clock: Clock):
    import felupe
    from scipy.sparse import csc_matrix

    with clock("assembly"):
        mesh = felupe.Mesh(case["nodes"], case["tets"], "tetra10")
        field = felupe.FieldContainer([felupe.Field(felupe.RegionQuadraticTetra(mesh), dim=3)])
        body = felupe.SolidBody(felupe.LinearElastic(E=1.0, nu=NU), field)
        whole = body.assemble.matrix()
        return csc_matrix(whole[case["free"]][:, case["free"]])


def _solves(clock: Clock, solve: Callable, load: np.ndarray) -> np.ndarray:
    with clock("one_solve"):
        moved = solve(load[:, :1])
    with clock("hundred_solves"):
        every = solve(load)
    assert np.allclose(every[:, 0], moved[:, 0], rtol=1e-6, atol=1e-9 * np.abs(moved).max())
    return moved[:, 0]


PEERS = {
    "drupe": (ours, ["fem"]),
    "drupe, 3000 compliances": (our_compliance, ["fem"]),
    "felupe + CHOLMOD": (felupe_cholmod, ["felupe", "sksparse"]),
    "felupe + MKL PARDISO": (felupe_pardiso, ["felupe", "pypardiso"]),
    "scikit-fem + scipy": (skfem_scipy, ["skfem"]),
    "NGSolve": (ngsolve, ["ngsolve"]),
    "CalculiX": (calculix, []),
}


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
