"""Print how far the strain energy of default meshes is from the converged one, case by case, nu .45 and .49.

    python benchmarks/convergence.py [CASE ...] [--cases FOLDER] [--dofs 100000] [--csv FILE]

Energy: twice the strain energy for E = 1 MPa under a fixed traction of 1 N. T10 and T4 run on the mesh that a
batch without settings gets; columns in percent. `t10`, `t4`: their energy over the converged one, less one;
`corrected`: T10 with the share put back that fem.solid.discretisation_error says is missing; `estimate`:
that share; `counted`: the standard deviation that a modulus gets for it; `effectivity`: estimate over truth.

Converged: T10 on meshes cut, step by step up to --dofs, where elements hold the error, its energies W and
their estimates s extrapolated by W (1 + k s) = W_converged with k from the same energies. So the limit does
not lean on the size of the estimate, only on its shrinking in step with the error. `below`: W of the finest
mesh, a lower bound (Galerkin); `peer`: its W (1 + s), another way to the limit; both over
the converged one, less one. --cases: a folder of ready-mesh cases (open-01/fruit.ply, pit.ply) for the
nectarine.
"""

import argparse
import csv
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, csr_array

from fem.elements.assembly import Stiffness, assemble, unit_lame_constants
from fem.estimation.modulus import ELEMENTS_SD, LEAST_SD
from fem.fem_failure import FemFailure
from fem.mesh.closest_point import closest_on_triangles
from fem.mesh.flesh_mesh import FleshMesh, refined_where, tetrahedralise
from fem.mesh.surface_points import locate
from fem.mesh.tetrahedra import signed_volumes_mm3
from fem.solid.discretisation_error import discretisation_error
from fem.solid.linear_solid import BASE_HEIGHT_MM, Support, UnitModulusSolid
from fem.solid.rigid_core import reduced, reduction
from fem.sparse.solver import factorise
from pipeline.batch.settings import MeshSettings as Sizes
from recon.surface.mesh_file import read_mesh

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from fem_shapes import ball, box, star, tetrahedron

Surface = tuple[np.ndarray, np.ndarray]
SHARE_CUT = 0.45
NU = (0.45, 0.49)


@dataclass(frozen=True)
class MeshCase:
    """A specimen, where it is loaded (N at points), and what holds it."""

    skin: Surface
    core: Surface
    at_mm: np.ndarray
    force_N: np.ndarray
    support: Support


@dataclass(frozen=True)
class ConvergenceRow:
    """One line of the table; shares in percent."""

    case: str
    nu: float
    dofs: int
    t10: float
    corrected: float
    t4: float
    estimate: float
    counted: float
    effectivity: float
    converged: float
    converged_dofs: int
    below: float
    peer: float


def press(width_mm: float, core: Surface) -> MeshCase:
    """Even pressure on a square of a 30 mm cube's top, its base held."""
    axis = ((np.arange(40) + 0.5) / 40 - 0.5) * width_mm
    u, v = (a.ravel() for a in np.meshgrid(axis, axis))
    at = np.column_stack([u, v, np.full(len(u), 15.0)])
    force = np.tile([0.0, 0.0, -1 / len(at)], (len(at), 1))
    return MeshCase(box((30, 30, 30)), core, at, force, "base")


def grasp(skin: Surface, core: Surface, radius_mm: float = 4.0) -> MeshCase:
    """Two pads along x, pressure like Hertz's on a disc under each."""
    axis = 2 * (np.arange(40) + 0.5) / 40 - 1
    y, z = (a.ravel() for a in np.meshgrid(axis, axis))
    y, z = y[y**2 + z**2 < 1], z[y**2 + z**2 < 1]
    weight = np.sqrt(1 - y**2 - z**2)
    middle = (skin[0].max(axis=0) + skin[0].min(axis=0)) / 2
    places, forces = [], []
    for side in (1, -1):
        at = middle + np.column_stack([np.zeros(len(y)), radius_mm * y, radius_mm * z])
        at[:, 0] += side * np.ptp(skin[0][:, 0]) / 2
        for _ in range(3):
            at[:, 0] = closest_on_triangles(at, *skin).point_mm[:, 0]
        places.append(at)
        forces.append(np.outer(weight / weight.sum(), [-side, 0.0, 0.0]))
    return MeshCase(skin, core, np.vstack(places), np.vstack(forces), "free")


def cases(folder: Path | None) -> dict[str, Callable[[], MeshCase]]:
    """All cases by name."""
    cube = box((12, 12, 12))
    found: dict[str, Callable[[], MeshCase]] = {
        f"press {a * a} mm2, cube": lambda a=a: press(a, cube) for a in (1, 3, 5, 10, 15)
    }
    found |= {
        "press 25 mm2, cube 4 mm up": lambda: press(5, box((12, 12, 12), centre_mm=(0, 0, 4))),
        "press 25 mm2, ball": lambda: press(5, ball(2000, semi_axes_mm=(7, 7, 7))),
        "press 25 mm2, star": lambda: press(5, star(14)),
        "press 25 mm2, tetrahedron": lambda: press(5, tetrahedron(16)),
        "grasp cuboid, ball": lambda: grasp(box((40, 30, 30)), ball(3000, semi_axes_mm=(10, 10, 10))),
    }
    if folder is not None:
        one = folder / "open-01"
        found["grasp nectarine"] = lambda: grasp(read_mesh(one / "fruit.ply"), read_mesh(one / "pit.ply"))
    return found


def load_on(mesh: FleshMesh, case: MeshCase) -> np.ndarray:
    """The case's forces on this mesh's nodes."""
    return locate(mesh, case.at_mm).point_load(case.force_N[None])


def solved(mesh: FleshMesh, case: MeshCase, nu: float, parts: Stiffness) -> tuple[float, float, np.ndarray]:
    """Energy, the share of it that the mesh is said to withhold, and each element's part of that."""
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=nu, support=case.support, parts=parts)
    load = load_on(mesh, case)
    moved = solid.displacement(load)
    error = discretisation_error(mesh, moved, poisson_ratio=nu)
    return float((load * moved).sum()), float(error.energy_share[0]), error.per_element[0]


def t4_energy(mesh: FleshMesh, case: MeshCase, nu: float) -> float:
    """The same energy with linear tetrahedra on the corners alone."""
    corner, tets = np.unique(mesh.tets[:, :4], return_inverse=True)
    nodes, tets = mesh.nodes_mm[corner], tets.reshape(-1, 4)
    span = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
    slope = np.linalg.inv(span).transpose(0, 2, 1)
    slope = np.concatenate([-slope.sum(axis=1, keepdims=True), slope], axis=1)
    mu, lame = unit_lame_constants(nu)
    h = np.einsum("mai,mbj->maibj", slope, slope)
    blocks = lame * h + mu * h.transpose(0, 1, 4, 3, 2)
    blocks += mu * np.einsum("mak,mbk,ij->maibj", slope, slope, np.eye(3))
    blocks *= signed_volumes_mm3(nodes, tets)[:, None, None, None, None]
    dof = (3 * tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    pairs = np.repeat(dof, 12, axis=1).ravel(), np.tile(dof, (1, 12)).ravel()
    matrix = csr_array(coo_array((blocks.ravel(), pairs), shape=2 * (3 * len(nodes),)))
    number = np.full(len(mesh.nodes_mm), -1)
    number[corner] = np.arange(len(corner))
    flat = mesh.outer_faces[:, :3]
    near = closest_on_triangles(case.at_mm, mesh.nodes_mm, flat)
    load = np.zeros((len(nodes), 3))
    for k in range(3):
        np.add.at(load, number[flat[near.face, k]], near.barycentric[:, [k]] * case.force_N)
    pit = number[np.intersect1d(mesh.pit_nodes, corner)]
    motions = csr_array(reduction(nodes, pit))
    free = np.ones(motions.shape[1], dtype=bool)
    if case.support == "base":
        held = np.flatnonzero(nodes[:, 2] <= nodes[:, 2].min() + BASE_HEIGHT_MM)
        free &= np.diff(csr_array(motions[(3 * held[:, None] + np.arange(3)).ravel()].T).indptr) == 0
    else:
        free[-6:] = False  # loads balance: holding the pit leaves no reaction
    motions = csr_array(motions.tocsc()[:, np.flatnonzero(free)])
    right = motions.T @ load.ravel()
    return float(right @ factorise(reduced(matrix, motions)).solve(right[:, None])[:, 0])


def adapted(mesh: FleshMesh, case: MeshCase, *, dofs: int) -> tuple[np.ndarray, int]:
    """Energy and estimate for both nu on meshes cut again and again where elements hold the error."""
    found = []
    while True:
        parts = assemble(mesh.nodes_mm, mesh.tets)
        answers = [solved(mesh, case, nu, parts) for nu in NU]
        found.append([answer[:2] for answer in answers])
        part, size = answers[-1][2], 3 * len(mesh.nodes_mm)
        if size >= dofs and len(found) > 1:
            return np.array(found), size
        order = np.argsort(-part)
        marked = np.zeros(len(part), dtype=bool)
        marked[order[: np.searchsorted(np.cumsum(part[order]), SHARE_CUT * part.sum()) + 1]] = True
        try:
            mesh = refined_where(mesh, marked, case.skin, case.core)
        except FemFailure as failure:
            print(f"  stopped at {size} dofs: {failure}")
            return np.array(found), size


def rows(name: str, case: MeshCase, *, dofs: int) -> Iterator[ConvergenceRow]:
    """Both Poisson's ratios."""
    mesh = tetrahedralise(*case.skin, *case.core, edge_mm=Sizes().edge_mm, refine_at_mm=case.at_mm)
    found, fine_dofs = adapted(mesh, case, dofs=dofs)
    for k, nu in enumerate(NU):
        energy, share = found[:, k].T
        # W + k W s = W_converged: two unknowns, a line through the meshes
        limit = float(np.polyfit(energy * share, energy, 1)[1])
        yield ConvergenceRow(
            name,
            nu,
            3 * len(mesh.nodes_mm),
            100 * (energy[0] / limit - 1),
            100 * (energy[0] * (1 + share[0]) / limit - 1),
            100 * (t4_energy(mesh, case, nu) / limit - 1),
            100 * share[0],
            100 * (LEAST_SD + ELEMENTS_SD * share[0]),
            share[0] / (limit / energy[0] - 1),
            limit,
            fine_dofs,
            100 * (energy[-1] / limit - 1),
            100 * (energy[-1] * (1 + share[-1]) / limit - 1),
        )


def main() -> None:
    """All cases, or those named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("only", nargs="*")
    parser.add_argument("--cases", type=Path)
    parser.add_argument("--dofs", type=int, default=100_000)
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    table = []
    locked: dict[float, list[float]] = {nu: [] for nu in NU}
    names = [field.name for field in fields(ConvergenceRow)]
    print("  ".join(names))
    for name, build in cases(args.cases).items():
        if args.only and name not in args.only:
            continue
        for row in rows(name, build(), dofs=args.dofs):
            line = [f"{v:.4g}" if isinstance(v, float) else str(v) for v in vars(row).values()]
            print("  ".join(line), flush=True)
            table.append(line)
            locked[row.nu].append(row.t4)
            if args.csv:
                with args.csv.open("w", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerows([names, *table])
    for nu, lack in locked.items():
        if lack:
            print(f"T4 locks at nu {nu}: {-max(lack):.0f} to {-min(lack):.0f} % of the energy missing")


if __name__ == "__main__":
    main()
