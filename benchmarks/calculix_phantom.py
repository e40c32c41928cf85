"""A ball of PDMS between two flat plates, around a rigid ball and without: truth for tests/batch.

    python benchmarks/calculix_phantom.py OUTPUT.csv

A ball of radius 20 mm, bonded to a rigid concentric ball of radius 8 mm, or solid. E = 1 MPa, nu = 0.45,
small strain. Contact by prescription, as in calculix_hertz.py: where the frictionless plate touches, r < a,
the skin is moved onto it, z = R - d, free to slide, and the approach d is the one for which the force at the
edge of the contact vanishes. CAX8R elements, symmetric about the equator; the core does not move. Needs `ccx`
(Debian: calculix-ccx; 2.20 made tests/data/phantom-ball-calculix.csv). Twice as many elements each way
(--finer 2) raise d by 0.14 % and the force by 0.24 % at most.
"""

import argparse
import csv
import tempfile
from pathlib import Path

import numpy as np
from calculix_hertz import WEDGES, solved

RADIUS_MM, CORE_MM, POISSON_RATIO = 20.0, 8.0, 0.45
CONTACTS_MM = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
EDGES_PER_CONTACT, EDGES_BEYOND, EDGES_DEEP = 24, 40, 40
AXIS_MM = 0.02
"""A solid ball is meshed around a hole this small, which softens it by (hole / ball)^3 = 1e-9."""


def shell(
    contact_mm: float, core_mm: float, finer: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (r, z) of a quarter, eight-node quadrilaterals, the skin's nodes from the pole, the core's."""
    edge = np.arcsin(contact_mm / RADIUS_MM)
    inside = edge * (1 - np.linspace(1, 0, 2 * finer * EDGES_PER_CONTACT + 1) ** 1.8)
    outside = edge + (np.pi / 2 - edge) * np.linspace(0, 1, 2 * finer * EDGES_BEYOND + 1) ** 2.6
    angle = np.concatenate([inside, outside[1:]])
    start = max(core_mm, AXIS_MM)
    ray = RADIUS_MM - (RADIUS_MM - start) * np.linspace(1, 0, 2 * finer * EDGES_DEEP + 1) ** 2.6
    place = np.stack([np.outer(np.sin(angle), ray), np.outer(np.cos(angle), ray)], axis=-1)
    place[0, :, 0] = 0.0
    place[-1, :, 1] = 0.0
    number = np.arange(angle.size * ray.size).reshape(angle.size, ray.size)
    used = np.ones(number.shape, dtype=bool)
    used[1::2, 1::2] = False
    number[used] = np.arange(used.sum())
    i, j = (
        grid.ravel()
        for grid in np.meshgrid(range(0, angle.size - 1, 2), range(0, ray.size - 1, 2), indexing="ij")
    )
    ways = [(0, 0), (0, 2), (2, 2), (2, 0), (0, 1), (1, 2), (2, 1), (1, 0)]
    elements = np.stack([number[i + a, j + b] for a, b in ways], axis=1)
    x = place[used][elements[:, :3]]
    if np.linalg.det(np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=1))[0] < 0:
        elements = elements[:, [0, 3, 2, 1, 7, 6, 5, 4]]
    return place[used], elements, number[:, -1], number[:, 0]


def levels(core_mm: float, scratch: Path, finer: int) -> list[list[object]]:
    """A line per corner node in contact and contact radius."""
    lines: list[list[object]] = []
    for contact_mm in CONTACTS_MM:
        nodes, elements, skin, inner = shell(contact_mm, core_mm, finer)
        on = skin[nodes[skin, 0] < contact_mm + 1e-6]
        corner = np.arange(len(on)) % 2 == 0
        gap = RADIUS_MM - nodes[on, 1]
        (u_one, f_one), (u_gap, f_gap) = solved(
            scratch / "ball.inp", nodes, elements, on, [-np.ones(len(on)), gap],
            element="CAX8R", held=inner if core_mm else inner[:0], E_MPa=1.0, poisson_ratio=POISSON_RATIO,
        )  # fmt: skip
        middle = np.flatnonzero(~corner)
        for force in (f_one, f_gap):
            for end in (-1, 1):
                force[middle + end] += force[middle] / 2
        approach = -f_gap[-1, 1] / f_one[-1, 1]
        u, force = approach * u_one + u_gap, WEDGES * (approach * f_one + f_gap)
        total = -force[corner, 1].sum()
        hertz = 4 / 3 / (1 - POISSON_RATIO**2) * RADIUS_MM**0.5 * approach**1.5
        print(
            f"core {core_mm} mm  a {contact_mm} mm  d {approach:.5f} mm  F {total:.5f} N  "
            f"over Hertz {total / hertz:.4f}"
        )
        lines += [
            [core_mm, contact_mm, f"{approach:.7g}", *(f"{v:.6g}" for v in (nodes[n, 0], *u[k], force[k, 1]))]
            for k, n in enumerate(on)
            if corner[k]
        ]
    return lines


def main() -> None:
    """Both balls."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("output", type=Path)
    parser.add_argument("--finer", type=int, default=1, help="so many times the elements each way")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        lines = [line for core in (CORE_MM, 0.0) for line in levels(core, Path(scratch), options.finer)]
    with options.output.open("w", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(["core_mm", "contact_mm", "approach_mm", "r_mm", "u_r_mm", "u_z_mm", "ring_force_N"])
        writer.writerows(lines)


if __name__ == "__main__":
    main()
