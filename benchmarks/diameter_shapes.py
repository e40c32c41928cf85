"""What three diameters miss of a fruit's shape: force between plates on whole skins over that on ellipsoids.

    python benchmarks/diameter_shapes.py [--fruits 8] [--seed 1]

draws nectarines, plums and cherries (samples/fruit.py, samples/kinds.py: hollows, groove, lopsided, pit off
its place), compresses each along x (suture), y (cheeks) and z (stem) by 4 % of its diameter between smooth
rigid plates in finite elements at small strain, and divides by the same on the ellipsoid with the fruit's
three diameters and the category's concentric pit share. The spread of ln of that ratio is what `shape_sd` of
fem/indentation/compressed_ellipsoid.py stands for; its median is an error that all fruit of a kind share.
Some 20 s a force.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import brentq, nnls

from fem.elements.assembly import assemble
from fem.indentation.compressed_ellipsoid import Ellipsoid
from fem.mesh.flesh_mesh import tetrahedralise
from fem.sparse.solver import factorise
from samples.cubed_sphere import even_sphere
from samples.fruit import fruit_of_seed, skin_mesh
from samples.kinds import fruit_of_kind

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from fem_shapes import ball

SQUEEZE = 0.04
"""Approach of the plates over the diameter between them."""
NU = 0.45
CELLS = 24
"""Of the skin's cubed sphere, along an edge of the cube."""
EDGE = 0.035
"""Length of elements at the plates over the fruit's radius; a contact is 0.28 of it wide."""
KINDS = ("nectarine", "plum", "waxy-plum", "cherry")


def force_between(outer, pit, axis, *, squeeze=SQUEEZE):
    """N for E = 1 MPa; the pit does not turn, and lies where both plates press alike."""
    vertices = outer[0]
    low, high = float(vertices[:, axis].min()), float(vertices[:, axis].max())
    poles = np.stack([vertices[vertices[:, axis].argmin()], vertices[vertices[:, axis].argmax()]])
    edge_mm = EDGE * (high - low) / 2
    mesh = tetrahedralise(
        *outer,
        *pit,
        edge_mm=0.17 * (high - low) / 2,
        refine_at_mm=poles,
        refine_radius_mm=9 * edge_mm,
        refine_edge_mm=edge_mm,
        dof_limit=60_000,
    )
    stiffness = assemble(mesh.nodes_mm, mesh.tets).for_unit_modulus(poisson_ratio=NU)
    moves = np.ones(stiffness.shape[0], dtype=bool)
    moves[(3 * mesh.pit_nodes[:, None] + np.arange(3)).ravel()] = False
    free = np.flatnonzero(moves)
    at = mesh.nodes_mm[mesh.outer_nodes, axis]
    whole = squeeze * (high - low)
    reach = 0.8 * whole
    touched = (at < low + reach) | (at > high - reach)
    skin, at = mesh.outer_nodes[touched], at[touched]
    side = np.where(at > (low + high) / 2, 1.0, -1.0)
    dof = np.searchsorted(free, 3 * skin + axis)
    load = np.zeros((len(free), len(skin)))
    load[dof, np.arange(len(skin))] = -side
    compliance = -side[:, None] * factorise(stiffness[free][:, free]).solve(load)[dof]
    root = np.linalg.cholesky((compliance + compliance.T) / 2)

    def forces(upper_mm):
        way = np.where(side > 0, upper_mm, whole - upper_mm)
        gap = way - np.where(side > 0, high - at, at - low)
        pressed, _ = nnls(root.T, np.linalg.solve(root, gap), maxiter=40_000)
        return pressed[side > 0].sum(), pressed[side < 0].sum()

    upper = brentq(lambda u: np.subtract(*forces(u)), 0.25 * whole, 0.75 * whole, xtol=0.002 * whole)
    return float(np.mean(forces(upper)))


def drawn(kind, seed):
    """Skin, pit and pit share of one fruit."""
    fruit = (
        fruit_of_seed("F", seed=seed, E_MPa=1.0) if kind == "nectarine" else fruit_of_kind(kind, seed=seed)
    )
    sphere = even_sphere(12)
    return skin_mesh(fruit.skin, cells=CELLS), (fruit.pit.points_mm(sphere.directions), sphere.triangles())


def main():
    """Draw, compress, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fruits", type=int, default=8, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    found = {}
    for kind in KINDS:
        for number in range(args.fruits):
            outer, pit = drawn(kind, 1000 * args.seed + number)
            box, core = (np.ptp(part[0], axis=0) for part in (outer, pit))
            share = float(np.cbrt(np.prod(core / box)))
            row = []
            for axis in range(3):
                fruit = Ellipsoid(diameters_mm=tuple(box), axis=axis, pit_share=share)
                plain = fruit.curve(thickness_mm=None, poisson_ratio=NU)
                ellipsoid = ball(6000, semi_axes_mm=box / 2), ball(1200, semi_axes_mm=share * box / 2)
                truth = force_between(outer, pit, axis)
                row.append((truth / force_between(*ellipsoid, axis), plain.shape_sd))
            found.setdefault(kind, []).append(row)
            print(kind, number, " ".join(f"{ratio:.3f}" for ratio, _ in row), flush=True)
    print("kind, axis, median ratio, sd of ln ratio, root mean square of ln ratio, stated sd")
    for kind, rows in found.items():
        for axis, name in enumerate(("suture", "cheeks", "stem")):
            log = np.log([row[axis][0] for row in rows])
            stated = np.mean([row[axis][1] for row in rows])
            rms = np.sqrt(np.mean(log**2))
            print(f"{kind}, {name}, {np.exp(np.median(log)):.3f}, {log.std():.3f}, {rms:.3f}, {stated:.3f}")


if __name__ == "__main__":
    main()
