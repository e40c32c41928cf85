"""Solvers of one problem, fem's own and its peers: each takes a case and gives the first load's displacement.

Phases are timed in processor seconds. The problem and what the peers need: solver_peers.py.
"""

import resource
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np

NU, LOADS = 0.45, 100
PHASES = ("assembly", "factor", "one_solve", "hundred_solves")
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
        factor = factorise(stiffness)
    with clock("hundred_solves"):
        compliance = factor.compliance(last)
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
