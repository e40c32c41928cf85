"""A cube around a rigid ball under large strain, solved by CalculiX with hexahedra: truth for fem's tests.

    python benchmarks/cube_calculix.py CELLS OUTPUT.csv

A cube of 20 mm around a rigid, bonded ball of radius 5 mm; its base z = 0 does not move. E = 1 MPa,
nu = 0.45, compressible Neo-Hookean (*HYPERELASTIC, NEO HOOKE), C3D20R, NLGEOM. On its top a dead traction of
PEAK_MPA times (1 - r^2 / 8^2)^2, r in mm from (13, 11), along DIRECTION. Printed to the file: displacements
of the top's corner nodes and of eight points of the ball. Needs `ccx` (Debian: calculix-ccx; 2.20 made
tests/data/cube-around-ball-calculix.csv, with 16 CELLS).
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SIDE_MM, RADIUS_MM = 20.0, 5.0
POISSON_RATIO = 0.45
PEAK_MPA, DIRECTION = 0.16, np.array([0.2, 0.1, -1.0])
CENTRE_MM, PATCH_MM = np.array([13.0, 11.0]), 8.0

#: C3D20: eight corners, then the middles of the edges below, around the top, and between
CORNERS = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]])
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
PLACES = np.vstack([CORNERS, [(CORNERS[a] + CORNERS[b]) // 2 for a, b in EDGES]])


def traction_MPa(points_mm: np.ndarray) -> np.ndarray:
    """The load on the top, force per area at rest."""
    r2 = ((points_mm[:, :2] - CENTRE_MM) ** 2).sum(axis=1) / PATCH_MM**2
    return PEAK_MPA * np.maximum(1 - r2, 0.0)[:, None] ** 2 * DIRECTION


def around_ball(grid_mm: np.ndarray) -> np.ndarray:
    """Points of a cube with a cubic hole of half its side, moved along rays: the hole becomes the ball."""
    ray = grid_mm - SIDE_MM / 2
    reach, length = np.abs(ray).max(axis=1), np.linalg.norm(ray, axis=1)
    outward = 4 * reach / SIDE_MM - 1
    at = (1 - outward) * RADIUS_MM + outward * SIDE_MM / 2 * length / reach
    return ray * (at / length)[:, None] + SIDE_MM / 2


def mesh(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the even grid (mm) and the twenty of each hexahedron, the core left out."""
    cell = np.stack(np.meshgrid(*3 * [np.arange(cells)], indexing="ij"), axis=-1).reshape(-1, 3)
    middle = (cell + 0.5) * SIDE_MM / cells
    cell = cell[(np.abs(middle - SIDE_MM / 2) > SIDE_MM / 4).any(axis=1)]
    grid = 2 * cell[:, None, :] + PLACES
    width = 2 * cells + 1
    used, elements = np.unique(grid @ np.array([width**2, width, 1]), return_inverse=True)
    nodes = np.stack(np.unravel_index(used, (width, width, width)), axis=1) * SIDE_MM / (2 * cells)
    return nodes, elements.reshape(len(cell), 20)


def face_shape(at: np.ndarray) -> np.ndarray:
    """Values of the eight-node square's functions at (q, 2): corners, then middles, counter-clockwise."""
    x, y = at.T[:, :, None]
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cx, cy = corner.T
    corners = (1 + cx * x) * (1 + cy * y) * (cx * x + cy * y - 1) / 4
    x, y = at.T
    middles = [(1 - x**2) * (1 - y), (1 + x) * (1 - y**2), (1 - x**2) * (1 + y), (1 - x) * (1 - y**2)]
    return np.hstack([corners, np.stack(middles, axis=1) / 2])


def top_load_N(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Consistent forces of the traction on the faces z = SIDE_MM."""
    faces = elements[:, [4, 5, 6, 7, 12, 13, 14, 15]]
    faces = faces[(nodes[faces[:, 0], 2] > SIDE_MM - 1e-9)]
    line, weight = np.polynomial.legendre.leggauss(8)
    at = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    shape, weights = face_shape(at), np.outer(weight, weight).ravel()
    load = np.zeros(nodes.shape)
    for face in faces:
        edge_mm = nodes[face[1], 0] - nodes[face[0], 0]
        np.add.at(
            load, face, shape.T @ (traction_MPa(shape @ nodes[face]) * weights[:, None] * edge_mm**2 / 4)
        )
    return load


def rows(label: str, numbers: np.ndarray) -> str:
    """A keyword and numbered nodes below it, eight a line."""
    lines = [", ".join(str(n + 1) for n in numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
    return "\n".join([label, *lines])


def deck(cells: int) -> tuple[str, np.ndarray]:
    """The input file, and where the printed nodes lie."""
    grid, elements = mesh(cells)
    nodes = around_ball(grid)
    core = np.flatnonzero((np.abs(grid - SIDE_MM / 2) < SIDE_MM / 4 + 1e-9).all(axis=1))
    base = np.flatnonzero(nodes[:, 2] < 1e-9)
    corner = np.unique(elements[:, :8])
    top = corner[nodes[corner, 2] > SIDE_MM - 1e-9]
    corners = core[(np.abs(np.abs(grid[core] - SIDE_MM / 2) - SIDE_MM / 4) < 1e-9).all(axis=1)]
    printed = np.concatenate([top, corners])
    mu, bulk = 0.5 / (1 + POISSON_RATIO), 1 / (3 - 6 * POISSON_RATIO)
    load = top_load_N(nodes, elements)
    n = len(nodes)
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{k + 1}, {x:.12g}, {y:.12g}, {z:.12g}" for k, (x, y, z) in enumerate(nodes)]
    middle = f"{SIDE_MM / 2:g}, {SIDE_MM / 2:g}, {SIDE_MM / 2:g}"
    lines += ["*NODE, NSET=CORE_MOTION", f"{n + 1}, {middle}", f"{n + 2}, {middle}"]
    lines += ["*ELEMENT, TYPE=C3D20R, ELSET=FLESH"]
    for k, e in enumerate(elements + 1):
        lines += [", ".join(map(str, [k + 1, *e[:10]])) + ",", ", ".join(map(str, e[10:]))]
    lines += [rows("*NSET, NSET=BASE", base), rows("*NSET, NSET=CORE", core)]
    lines += [rows("*NSET, NSET=PRINTED", printed)]
    lines += [f"*RIGID BODY, NSET=CORE, REF NODE={n + 1}, ROT NODE={n + 2}"]
    lines += ["*MATERIAL, NAME=PULP", "*HYPERELASTIC, NEO HOOKE", f"{mu / 2:.12g}, {2 / bulk:.12g}"]
    lines += ["*SOLID SECTION, ELSET=FLESH, MATERIAL=PULP", "*BOUNDARY", "BASE, 1, 3"]
    lines += ["*STEP, NLGEOM, INC=200", "*STATIC", "0.25, 1.0", "*CLOAD"]
    lines += [f"{k + 1}, {i + 1}, {load[k, i]:.12g}" for k, i in zip(*np.nonzero(load), strict=True)]
    lines += ["*NODE PRINT, NSET=PRINTED, FREQUENCY=1000", "U", "*END STEP"]
    return "\n".join(lines) + "\n", nodes[printed]


def main() -> None:
    """Write, solve, keep the last table of displacements."""
    cells, output = int(sys.argv[1]), Path(sys.argv[2])
    text, place = deck(cells)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "cube.inp").write_text(text)
        run = subprocess.run(["ccx", "cube"], cwd=folder, capture_output=True, text=True, check=False)
        table = [line.split() for line in (Path(folder) / "cube.dat").read_text().splitlines()]
    if "Job finished" not in run.stdout:
        raise SystemExit(run.stdout[-2000:])
    moved = np.array([[float(v) for v in row[1:]] for row in table if len(row) == 4][-len(place) :])
    header = (
        f"benchmarks/cube_calculix.py {cells}: CalculiX 2.20, C3D20R, Neo-Hookean, E = 1 MPa, nu = 0.45; "
        "the load is in that script\nx_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"
    )
    np.savetxt(output, np.hstack([place, moved]), fmt="%.7g", delimiter=",", header=header)
    print(f"{len(place)} nodes, largest displacement {np.abs(moved).max():.4f} mm")


if __name__ == "__main__":
    main()
