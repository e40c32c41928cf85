"""Tables of squeezed spheroids and bonded cylinders by finite elements, their convergence, and closed forms.

    python benchmarks/indentation_geometries.py [--write]

prints how the finite elements of tests/fem/compressed_solid.py converge, and how far the curves of
fem/indentation are from them at shapes between those of the tables
(benchmarks/results/indentation_geometries.csv); --write makes fem/indentation/tables/*.csv anew first, some
ten minutes.
"""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from script import run

from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.compressed_ellipsoid import Ellipsoid
from fem.indentation.flat_punch import FlatPunch

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from compressed_solid import cylinder, neo_hookean, punched_slab, spheroid
from triaxial_fruit import force_between

TABLES = Path(__file__).parents[1] / "fem" / "indentation" / "tables"
RESULTS = Path(__file__).parent / "results" / "indentation_geometries.csv"
RATIOS = (0.2, 0.3, 0.4, 0.45, 0.48, 0.495)
"""Poisson's, of cylinders; spheroids, whose curves are smoother in it, have ROUND_RATIOS."""
ROUND_RATIOS = (0.2, 0.35, 0.45, 0.495)
PITS = (0.0, 0.2, 0.35, 0.5, 0.65)
LONG = (0.625, 0.8, 1.0, 1.25, 1.6)
"""Diameter between the plates over that across."""
SQUEEZES = (0.005, 0.01, 0.02, 0.04, 0.07, 0.1, 0.14, 0.18, 0.22, 0.25)
"""Approach of the plates over the diameter between them."""
SLENDER = (0.25, 0.35, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Height over diameter of bonded cylinders."""
STRAINS = (0.001, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)


def over_hertz(solid, squeezes, *, nu, along):
    """Force over Hertz's, 1 across and E = 1; each contact has the half of the approach; NaN at the end."""
    force = np.full(len(squeezes), np.nan)
    for k, x in enumerate(squeezes):
        try:
            force[k] = solid.force_at(along * (1 - x))
        except RuntimeError:
            break
    return force / (4 / 3 / (1 - nu**2) * np.sqrt(1 / along) * (along * np.asarray(squeezes)) ** 1.5)


def over_modulus(solid, strains, *, radius, height):
    """Nominal stress over strain, E = 1; from where the elements give up it grows as by its last step."""
    ratios = np.zeros(len(strains))
    for k, strain in enumerate(strains):
        try:
            ratios[k] = solid.force_at(height / 2 * (1 - strain)) / (np.pi * radius**2 * strain)
        except RuntimeError:
            ratios[k] = ratios[k - 1] ** 2 / ratios[k - 2]
    return ratios


def spheroids():
    """Rows of the table of spheroids with round rigid pits."""
    for nu, pit, along in product(ROUND_RATIOS, PITS, LONG):
        solid = spheroid(nu=nu, pit_share=pit, along=along, round_=34, out=10)
        ratio = over_hertz(solid, SQUEEZES, nu=nu, along=along)
        print(nu, pit, along, ratio.round(4), flush=True)
        yield from ([nu, pit, along, x, f"{y:.5g}"] for x, y in zip(SQUEEZES, ratio, strict=True))


def cylinders():
    """Rows of the table of bonded cylinders."""
    for nu, slender in product(RATIOS, SLENDER):
        solid = cylinder(nu=nu, radius=0.5, height=slender, bonded=True, across=16, up=12)
        ratio = over_modulus(solid, STRAINS, radius=0.5, height=slender)
        print(nu, slender, ratio.round(4), flush=True)
        yield from ([nu, slender, x, f"{y:.5g}"] for x, y in zip(STRAINS, ratio, strict=True))


def write_table(path, columns, rows):
    """A table as CSV."""
    pd.DataFrame(rows, columns=columns.split()).to_csv(path, index=False)


def force(geometry, approach_mm, *, nu=0.45, thickness_mm=None):
    """N per MPa, by the curve of fem/indentation."""
    curve = geometry.curve(thickness_mm=thickness_mm, poisson_ratio=nu)
    return float(curve.force_N_per_MPa(np.array(approach_mm)))


def checks():
    """Rows of the results: what is compared, at which depth, the curve's force over the elements'."""
    for cells in ((20, 8), (28, 10), (34, 10), (40, 14), (52, 18)):
        solid = spheroid(nu=0.45, pit_share=0.4, round_=cells[0], out=cells[1])
        fruit = Ellipsoid(diameters_mm=(2.0, 2.0, 2.0), axis=2, pit_share=0.4)
        for x in (0.02, 0.1, 0.2):
            over = force(fruit, 2 * x) / solid.force_at(1 - x)
            yield "sphere, pit 0.4", f"{cells[0]} x {cells[1]} elements", x, over
    for nu, along, pit in ((0.41, 0.88, 0.27), (0.47, 1.12, 0.57), (0.3, 1.4, 0.1), (0.25, 0.7, 0.45)):
        solid = spheroid(nu=nu, along=along, pit_share=pit, round_=40, out=14)
        fruit = Ellipsoid(diameters_mm=(2.0, 2.0, 2 * along), axis=2, pit_share=pit)
        for x in (0.02, 0.1, 0.2):
            over = force(fruit, 2 * along * x, nu=nu) / solid.force_at(along * (1 - x))
            yield f"spheroid {along:g}, pit {pit:g}, nu {nu:g}", "between the table's shapes", x, over
    for semi in ((30.0, 29.0, 26.0), (30.0, 27.0, 30.0)):
        fruit = Ellipsoid(diameters_mm=tuple(2 * s for s in semi), axis=2, pit_share=0.4)
        for x, edge_mm in ((0.03, 1.4), (0.03, 1.0), (0.05, 1.0)):
            truth = force_between(semi, pit_share=0.4, nu=0.45, squeeze=x, edge_mm=edge_mm)
            over = force(fruit, 2 * semi[2] * x) / truth
            yield f"triaxial {semi}, pit 0.4", f"tetrahedra at small strain, {edge_mm:g} mm", x, over
    for across, up in ((10, 8), (16, 12), (24, 18), (32, 24)):
        solid = cylinder(nu=0.45, radius=0.5, height=0.8, bonded=True, across=across, up=up)
        rod = Cylinder(diameter_mm=1.0, height_mm=0.8, ends="bonded")
        for e in (0.02, 0.1, 0.2, 0.3):
            over = force(rod, 0.8 * e) / solid.force_at(0.4 * (1 - e))
            yield "bonded cylinder, height 0.8 D", f"{across} x {up} elements", e, over
    for across, up in ((8, 6), (12, 9)):
        solid = cylinder(nu=0.49, radius=0.5, height=0.6, bonded=True, across=across, up=up, sides_touch=True)
        rod = Cylinder(diameter_mm=1.0, height_mm=0.6, ends="bonded")
        for e in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.67):
            over = force(rod, 0.6 * e, nu=0.49) / solid.force_at(0.3 * (1 - e))
            yield "bonded cylinder, height 0.6 D, sides touch", f"{across} x {up} elements", e, over
    for inside, outside, down in ((10, 12, 10), (16, 20, 16), (24, 28, 22)):
        for thick in (5.0, 1.0, 0.5):
            cells = {"inside": inside, "outside": outside, "down": down}
            slab = punched_slab(nu=0.45, radius=1.0, thickness=thick, wide=8 + 4 * thick, **cells)
            over = force(FlatPunch(radius_mm=1.0), 0.01, thickness_mm=thick) / slab.force_at(thick - 0.01)
            yield f"punch, slab of {thick:g} radii", f"{inside + outside} x {down} elements", 0.01, over
    slab = punched_slab(nu=0.45, radius=1.0, thickness=2.0, wide=16.0, law=neo_hookean)
    for d in (0.05, 0.1, 0.2, 0.3):
        over = force(FlatPunch(radius_mm=1.0), d, thickness_mm=2.0) / slab.force_at(2 - d)
        yield "punch, slab of 2 radii", "finite strain", d, over


def main(write: bool = False) -> None:
    """Makes the tables where it is asked to, compares, prints."""
    if write:
        TABLES.mkdir(exist_ok=True)
        spheroid_columns = "poisson_ratio pit_share along_over_across squeeze over_hertz"
        write_table(TABLES / "compressed_spheroid.csv", spheroid_columns, spheroids())
        cylinder_columns = "poisson_ratio height_over_diameter strain over_modulus"
        write_table(TABLES / "bonded_cylinder.csv", cylinder_columns, cylinders())
    rows = [[*row, f"{over:.4f}"] for *row, over in checks()]
    write_table(RESULTS, "geometry truth squeeze_or_depth curve_over_truth", rows)
    print(pd.DataFrame(rows).to_string(index=False, header=False))


if __name__ == "__main__":
    run(main)
