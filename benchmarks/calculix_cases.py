"""Solve the specimens of paper.py with CalculiX and keep the reactions of the patches' nodes.

    python benchmarks/calculix_cases.py [NAME ...] [--scratch FOLDER]

Needs `ccx` (Debian: calculix-ccx) and gmsh (PyPI), which paper.py does not. Writes forward/NAME.npz and the
case's line of forward/solved.csv: element, degrees of freedom, seconds, and how much less force a mesh about
half as fine gives (the forward data's own discretisation error is a fraction of that).
"""

import argparse
import csv
import datetime
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from calculix_deck import solve, write_deck
from calculix_mesh import Core, Mesh, Patch, Specimen, bricks, tetrahedra

HERE = Path(__file__).parent / "forward"
POISSON_RATIO, E_MPA = 0.45, 0.1
LEVELS = (0.2, 0.4, 0.6, 0.8, 1.0)
CUBE = {"low_mm": (-15.0, -15.0, -15.0), "high_mm": (15.0, 15.0, 15.0), "base_fixed": True}
CUBOID = {"low_mm": (-20.0, -15.0, -15.0), "high_mm": (20.0, 15.0, 15.0), "base_fixed": False}
CORES = {"cube": 12.0, "star": 12.0, "tetrahedron": 12.0, "ball": 12.0 * (3 / 4 / np.pi) ** (1 / 3)}
SHIFT_MM = 4.0


@dataclass(frozen=True, kw_only=True)
class CalculixCase:
    """One forward solution: what is pressed, how far each patch goes at level 1, how finely it is solved."""

    specimen: Specimen
    moves_mm: tuple[tuple[float, float, float], ...]
    mesher: str
    rim_mm: float
    growth: float
    largest_mm: float
    levels: tuple[float, ...] = (1.0,)
    finite: bool = False


def press(
    *, core: Core, mirrors: tuple[int, ...], edge_mm: float = 10.0, at_mm: float = 0.0, side: bool = False
) -> tuple[Specimen, tuple[tuple[float, float, float], ...]]:
    """One pad pushes 1 mm into the top of the cube, at_mm along x off its middle, or into its side."""
    patch = Patch(
        axis=0 if side else 2,
        side=1,
        centre_mm=(15.0, 0.0, 0.0) if side else (at_mm, 0.0, 15.0),
        edge_mm=edge_mm,
    )
    specimen = Specimen(**CUBE, core=core, mirrors=mirrors, patches=(patch,))
    return specimen, ((-1.0, 0.0, 0.0) if side else (0.0, 0.0, -1.0),)


def grasp(
    *, core: Core, mirrors: tuple[int, ...], axis: int = 0
) -> tuple[Specimen, tuple[tuple[float, float, float], ...]]:
    """Two pads of 10 mm close by 1 mm each along an axis of the cuboid; a mirror stands for the second."""
    patches, moves = [], []
    for side in (1, -1)[: 1 if axis in mirrors else 2]:
        centre = [0.0, 0.0, 0.0]
        centre[axis] = side * CUBOID["high_mm"][axis]
        patches.append(Patch(axis=axis, side=side, centre_mm=tuple(centre), edge_mm=10.0))
        moves.append(tuple(-side * float(k == axis) for k in range(3)))
    return Specimen(**CUBOID, core=core, mirrors=mirrors, patches=tuple(patches)), tuple(moves)


def cases() -> dict[str, CalculixCase]:
    """Every forward solution, by name."""
    fine = {"mesher": "bricks", "growth": 0.55, "largest_mm": 2.5}
    finest = {"mesher": "bricks", "growth": 0.4, "largest_mm": 2.5}
    half = {"mesher": "bricks", "rim_mm": 0.2, "growth": 0.6, "largest_mm": 3.0}
    tets = {"mesher": "tetrahedra", "rim_mm": 0.06, "growth": 0.25, "largest_mm": 2.0}
    plain = {"mesher": "bricks", "rim_mm": 0.25, "growth": 0.5, "largest_mm": 3.0}
    quarter = {"mesher": "tetrahedra", "rim_mm": 0.1, "growth": 0.25, "largest_mm": 2.0}
    deep = {"mesher": "tetrahedra", "rim_mm": 0.05, "growth": 0.2, "largest_mm": 1.6}
    shallow = {"mesher": "tetrahedra", "rim_mm": 0.2, "growth": 0.3, "largest_mm": 2.5}
    cube, ball = Core(shape="cube", size_mm=12.0), Core(shape="ball", size_mm=10.0)
    found: dict[str, CalculixCase] = {}

    def add(name: str, setting: tuple, **how: object) -> None:
        specimen, moves = setting
        found[name] = CalculixCase(specimen=specimen, moves_mm=moves, **how)

    for edge in (1.0, 3.0, 5.0, 10.0, 15.0):
        how = {"rim_mm": 0.05, **finest} if edge == 10.0 else {"rim_mm": edge / 100, **fine}
        add(f"press-{edge**2:.0f}mm2", press(core=cube, mirrors=(0, 1), edge_mm=edge), **how)
    add("press-linear", press(core=cube, mirrors=(0, 1)), **plain)
    add("press-neo-hookean", press(core=cube, mirrors=(0, 1)), levels=LEVELS, finite=True, **plain)
    add("grasp", grasp(core=ball, mirrors=(0, 1, 2)), **deep)
    add("grasp-linear", grasp(core=ball, mirrors=(0, 1, 2)), **shallow)
    add("grasp-neo-hookean", grasp(core=ball, mirrors=(0, 1, 2)), levels=LEVELS, finite=True, **shallow)
    for at in (2.0, 4.0, 6.0, 8.0):
        add(f"press-at-{at:.0f}mm", press(core=cube, mirrors=(1,), at_mm=at), **half)
    for shape, size in CORES.items():
        add(f"press-{shape}", press(core=Core(shape=shape, size_mm=size), mirrors=(0, 1)), **tets)
    for along, name in ((0, "x"), (2, "z")):
        shifted = replace(cube, centre_mm=tuple(SHIFT_MM * (k == along) for k in range(3)))
        add(f"press-top-core-{name}", press(core=shifted, mirrors=(0, 1) if along == 2 else (1,)), **half)
        add(f"press-side-core-{name}", press(core=shifted, mirrors=(1,), side=True), **half)
    for along, name in ((0, "x"), (1, "y")):
        shifted = replace(ball, centre_mm=tuple(SHIFT_MM * (k == along) for k in range(3)))
        for axis, jaws in ((0, "x"), (1, "y")):
            mirrors = tuple(k for k in range(3) if k != along and (k == axis or k == 2 or along == axis))
            add(f"grasp-{jaws}-core-{name}", grasp(core=shifted, mirrors=mirrors, axis=axis), **quarter)
    return found


def meshed(case: CalculixCase, *, coarser: float = 1.0) -> Mesh:
    """The case's mesh, or a coarser one."""
    mesher = {"bricks": bricks, "tetrahedra": tetrahedra}[case.mesher]
    return mesher(
        case.specimen,
        rim_mm=case.rim_mm * coarser,
        growth=case.growth * coarser**0.5,
        largest_mm=case.largest_mm * coarser**0.5,
    )


def on_corners(mesh: Mesh, nodes: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Forces of mid-edge nodes halved onto their corners: the work of the reactions on linear fields.

    The nodal forces of quadratic elements under even pressure alternate; these are traction times cell.
    """
    row = np.full(len(mesh.nodes_mm), -1)
    row[nodes] = np.arange(len(nodes))
    a, b, middle = row[mesh.edges[(row[mesh.edges] >= 0).all(axis=1)]].T
    moved = force_N.copy()
    moved[:, middle] = 0.0
    for end in (a, b):
        np.add.at(moved, (slice(None), end), force_N[:, middle] / 2)
    return moved


def run(name: str, case: CalculixCase, scratch: Path) -> dict[str, object]:
    """Solve, keep, and say how well."""
    pads = case.specimen.patches
    moves, work, dofs, kept = np.array(case.moves_mm), [], [], None
    for coarser in (2.0, 1.0):
        mesh = meshed(case, coarser=coarser)
        levels = case.levels if coarser == 1.0 else (1.0,)
        path = scratch / f"{name}.inp"
        nodes = write_deck(
            path,
            case.specimen,
            mesh,
            E_MPa=E_MPA,
            poisson_ratio=POISSON_RATIO,
            moves_mm=moves,
            levels=levels,
            finite=case.finite and coarser == 1.0,
        )
        kept = solve(path, nodes, levels=len(levels))
        place = mesh.nodes_mm[nodes]
        owner = np.array([next(k for k, pad in enumerate(pads) if pad.holds(p[None])[0]) for p in place])
        work.append(float((kept.force_N[-1] * moves[owner]).sum()) * 2 ** len(case.specimen.mirrors))
        dofs.append(mesh.nodes_mm.size)
    corners = np.isin(nodes, mesh.elements[:, : 8 if mesh.elements.shape[1] == 20 else 4])
    force = on_corners(mesh, nodes, kept.force_N)
    core = case.specimen.core
    np.savez_compressed(
        HERE / f"{name}.npz",
        place_mm=place[corners].astype(np.float32),
        pad=owner[corners].astype(np.int8),
        force_N=force[:, corners].astype(np.float32),
        levels=np.array(case.levels),
        moves_mm=moves,
        mirrors=np.array(case.specimen.mirrors, dtype=np.int8),
        low_mm=np.array(case.specimen.low_mm),
        high_mm=np.array(case.specimen.high_mm),
        core=np.array([core.shape]),
        core_size_mm=np.array(core.size_mm),
        core_centre_mm=np.array(core.centre_mm),
        patch_edge_mm=np.array([pad.edge_mm for pad in pads]),
        patch_centre_mm=np.array([pad.centre_mm for pad in pads]),
        patch_axis=np.array([pad.axis for pad in pads]),
    )
    return {
        "case": name,
        "element": {"bricks": "C3D20R", "tetrahedra": "C3D10"}[case.mesher],
        "mirrors": "".join("xyz"[k] for k in case.specimen.mirrors),
        "dofs": dofs[1],
        "coarser_dofs": dofs[0],
        "work_N_mm": f"{work[1]:.5f}",
        "coarser_work_change_percent": "" if case.finite else f"{100 * (work[0] / work[1] - 1):.2f}",
        "seconds": f"{kept.seconds:.0f}",
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
    }


def main() -> None:
    """All cases, or those named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*")
    parser.add_argument("--scratch", type=Path, required=True, help="where decks and solver output go")
    options = parser.parse_args()
    print(subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False).stdout.strip())
    table = HERE / "solved.csv"
    for name, case in cases().items():
        if options.names and name not in options.names:
            continue
        row = run(name, case, options.scratch)
        print(*row.values(), flush=True)
        rows = list(csv.DictReader(table.open())) if table.exists() else []
        rows = sorted([r for r in rows if r["case"] != name] + [row], key=lambda r: str(r["case"]))
        with table.open("w", newline="") as out:
            writer = csv.DictWriter(out, fieldnames=list(row), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
