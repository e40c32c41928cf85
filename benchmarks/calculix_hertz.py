"""A ball without a core between two flat frictionless plates, by CalculiX in two dimensions.

    python benchmarks/calculix_hertz.py --scratch FOLDER

Contact by prescription: where the plate touches, r < a, the skin is moved onto it, z = R - d, free to slide,
and the approach d is the one for which the force at the edge of the contact vanishes. The problem is linear,
so that two solutions (d alone, the ball's gap alone) make every d. CAX6 elements by gmsh, symmetric about the
equator; the reactions that ccx prints are those of its wedge of two degrees. The ball is large, so that
contacts of millimetres are small against it. Writes forward/ball-between-plates.csv.
"""

import argparse
import csv
import os
import re
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent / "forward"
RADIUS_MM, E_MPA, POISSON_RATIO = 300.0, 0.1, 0.45
CONTACTS_MM = (1.5, 3.0, 4.5, 6.0)
EDGES_PER_CONTACT = 40
WEDGES = 180


def quarter_disc(contact_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (r, z), six-node triangles, and the arc's corner and mid-edge nodes in order from the pole."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    geo = gmsh.model.occ
    middle, side, pole = geo.addPoint(0, 0, 0), geo.addPoint(RADIUS_MM, 0, 0), geo.addPoint(0, RADIUS_MM, 0)
    edge_angle = np.arcsin(contact_mm / RADIUS_MM)
    edge = geo.addPoint(contact_mm, RADIUS_MM * np.cos(edge_angle), 0)
    lines = [geo.addLine(middle, side), geo.addCircleArc(side, middle, edge)]
    lines += [geo.addCircleArc(edge, middle, pole), geo.addLine(pole, middle)]
    geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    field = gmsh.model.mesh.field
    size = field.add("MathEval")
    fine = contact_mm / EDGES_PER_CONTACT
    field.setString(size, "F", f"{fine} + 0.1*max(0, sqrt(x*x+(y-{RADIUS_MM})^2) - {1.2 * contact_mm})")
    field.setAsBackgroundMesh(size)
    for name in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{name}", 0)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    _, _, connectivity = gmsh.model.mesh.getElements(2)
    gmsh.finalize()
    used, elements = np.unique(np.array(connectivity[0]).reshape(-1, 6), return_inverse=True)
    row = np.full(int(tags.max()) + 1, -1)
    row[tags.astype(int)] = np.arange(len(tags))
    nodes = xyz.reshape(-1, 3)[row[used.astype(int)], :2]
    elements = elements.reshape(-1, 6)
    x = nodes[elements[:, :3]]
    turn = np.linalg.det(np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=1)) < 0
    elements[turn] = elements[turn][:, [0, 2, 1, 5, 4, 3]]
    arc = np.flatnonzero(np.abs(np.linalg.norm(nodes, axis=1) - RADIUS_MM) < 1e-6)
    arc = arc[np.argsort(nodes[arc, 0])]
    corner = np.isin(arc, elements[:, :3])
    return nodes, elements, arc, corner


def solved(
    path: Path,
    nodes: np.ndarray,
    elements: np.ndarray,
    on: np.ndarray,
    moves: list[np.ndarray],
    *,
    element: str = "CAX6",
    held: np.ndarray | tuple[int, ...] = (),
    E_MPa: float = E_MPA,
    poisson_ratio: float = POISSON_RATIO,
) -> list:
    """Displacement and reaction (r, z) of the nodes `on` for each prescribed motion along z of them.

    The nodes `held` do not move.
    """
    with path.open("w") as deck:
        deck.write("*NODE, NSET=NALL\n")
        deck.writelines(f"{n}, {r:.10g}, {z:.10g}, 0.\n" for n, (r, z) in enumerate(nodes, start=1))
        deck.write(f"*ELEMENT, TYPE={element}, ELSET=FLESH\n")
        deck.writelines(f"{n}, " + ", ".join(map(str, e)) + "\n" for n, e in enumerate(elements + 1, start=1))
        deck.write(f"*MATERIAL, NAME=FLESH\n*ELASTIC\n{E_MPa}, {poisson_ratio}\n")
        deck.write("*SOLID SECTION, ELSET=FLESH, MATERIAL=FLESH\n*NSET, NSET=PAD\n")
        deck.writelines(f"{n + 1}\n" for n in on)
        deck.write("*BOUNDARY\n")
        deck.writelines(f"{n + 1},2,2\n" for n in np.flatnonzero(np.abs(nodes[:, 1]) < 1e-9))
        deck.writelines(f"{n + 1},1,1\n" for n in np.flatnonzero(np.abs(nodes[:, 0]) < 1e-9))
        deck.writelines(f"{n + 1},1,2\n" for n in held)
        for move in moves:
            deck.write("*STEP\n*STATIC\n*BOUNDARY\n")
            deck.writelines(f"{n + 1},2,2,{u:.12g}\n" for n, u in zip(on, move, strict=True))
            deck.write("*NODE PRINT, NSET=PAD\nU, RF\n*END STEP\n")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(
        ["ccx", "-i", path.stem], cwd=path.parent, env=environment, capture_output=True, check=True
    )
    text = path.with_suffix(".dat").read_text()
    blocks = re.split(r"\n\s*(?:forces|displacements).*\n", "\n" + text)[1:]
    found = []
    for block in blocks:
        rows = np.array([line.split() for line in block.strip().splitlines()], dtype=float)
        table = dict(zip(rows[:, 0].astype(int), rows[:, 1:3], strict=True))
        found.append(np.array([table[n + 1] for n in on]))
    return [(found[2 * k], found[2 * k + 1]) for k in range(len(moves))]


def main() -> None:
    """One line per corner node in contact and contact radius."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scratch", type=Path, required=True)
    scratch = parser.parse_args().scratch
    lines = []
    for contact_mm in CONTACTS_MM:
        nodes, elements, arc, corner = quarter_disc(contact_mm)
        inside = nodes[arc, 0] < contact_mm + 1e-6
        on, corner = arc[inside], corner[inside]
        gap = RADIUS_MM - nodes[on, 1]
        (u_one, f_one), (u_gap, f_gap) = solved(
            scratch / "ball.inp", nodes, elements, on, [-np.ones(len(on)), gap]
        )
        middle = np.flatnonzero(~corner)
        for force in (f_one, f_gap):
            for end in (-1, 1):
                force[middle + end] += force[middle] / 2
        approach = -f_gap[-1, 1] / f_one[-1, 1]
        u, force = approach * u_one + u_gap, WEDGES * (approach * f_one + f_gap)
        total = -force[corner, 1].sum()
        hertz = 4 / 3 * E_MPA / (1 - POISSON_RATIO**2) * RADIUS_MM**0.5 * approach**1.5
        print(
            f"a {contact_mm} mm  dofs {2 * len(nodes)}  "
            f"d {approach:.6f} mm (a2/R {contact_mm**2 / RADIUS_MM:.6f})  "
            f"F {total:.6f} N  over Hertz {total / hertz:.4f}"
        )
        lines += [
            [contact_mm, f"{approach:.7f}", *(f"{v:.8g}" for v in (*nodes[n], *u[k], *force[k]))]
            for k, n in enumerate(on)
            if corner[k]
        ]
    with (HERE / "ball-between-plates.csv").open("w", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(
            [
                "contact_mm",
                "approach_mm",
                "r_mm",
                "z_mm",
                "u_r_mm",
                "u_z_mm",
                "ring_force_r_N",
                "ring_force_N",
            ]
        )
        writer.writerows(lines)


if __name__ == "__main__":
    main()
