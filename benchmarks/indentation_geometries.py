"""Tables of squeezed spheroids and bonded cylinders by finite elements, their convergence, and closed forms.

    python benchmarks/indentation_geometries.py [--write]

prints how the finite elements of tests/fem/compressed_solid.py converge, and how far the curves of
fem/indentation are from them at shapes between those of the tables
(benchmarks/results/indentation_geometries.csv); --write makes fem/indentation/tables/*.csv anew first, some
ten minutes.
"""

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from compressed_solid import cylinder, spheroid

TABLES = Path(__file__).parents[1] / "fem" / "indentation" / "tables"
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
STRAINS = (0.001, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35)


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
    """Nominal stress over strain, E = 1; NaN from where the elements give up."""
    found = np.full(len(strains), np.nan)
    for k, strain in enumerate(strains):
        try:
            found[k] = solid.force_at(height / 2 * (1 - strain)) / (np.pi * radius**2 * strain)
        except RuntimeError:
            break
    return found


def write_spheroids():
    """Round rigid pits."""
    with (TABLES / "compressed_spheroid.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["poisson_ratio", "pit_share", "along_over_across", "squeeze", "over_hertz"])
        for nu in ROUND_RATIOS:
            for pit in PITS:
                for along in LONG:
                    solid = spheroid(nu=nu, pit_share=pit, along=along, round_=34, out=10)
                    ratio = over_hertz(solid, SQUEEZES, nu=nu, along=along)
                    rows = zip(SQUEEZES, ratio, strict=True)
                    table.writerows([nu, pit, along, x, f"{y:.5g}"] for x, y in rows)
                    print(nu, pit, along, ratio.round(4), flush=True)


def write_cylinders():
    """Bonded ones."""
    with (TABLES / "bonded_cylinder.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["poisson_ratio", "height_over_diameter", "strain", "over_modulus"])
        for nu in RATIOS:
            for slender in SLENDER:
                solid = cylinder(nu=nu, radius=0.5, height=slender, bonded=True, across=16, up=12)
                ratio = over_modulus(solid, STRAINS, radius=0.5, height=slender)
                table.writerows([nu, slender, x, f"{y:.5g}"] for x, y in zip(STRAINS, ratio, strict=True))
                print(nu, slender, ratio.round(4), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    if parser.parse_args().write:
        TABLES.mkdir(exist_ok=True)
        write_spheroids()
        write_cylinders()
