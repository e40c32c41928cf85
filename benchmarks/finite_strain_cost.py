"""What large deformation costs on a fruit of about 60 thousand degrees of freedom, in CPU seconds.

    OMP_NUM_THREADS=1 python benchmarks/finite_strain_cost.py

A nectarine between two smooth oblique pads, forces of 1 to 10 N per MPa of its modulus, Neo-Hookean.
"""

import time

import numpy as np
from scipy.spatial import ConvexHull

from fem.materials.neo_hookean import NeoHookean
from fem.mesh.flesh_mesh import tetrahedralise
from fem.mesh.surface_points import skin_quadrature
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import UnitModulusSolid

FORCES_N_PER_MPA = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0)


def ellipsoid(count: int, semi_axes_mm: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A surface of points on a spiral."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - height**2)
    unit = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    faces = ConvexHull(unit).simplices
    corner = unit[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = (normal * corner[:, 0]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return unit * np.array(semi_axes_mm), faces.astype(np.int64)


def main() -> None:
    """Print a row for each Poisson's ratio and tolerance."""
    mesh = tetrahedralise(*ellipsoid(4000, (30.5, 29.5, 28.5)), *ellipsoid(2000, (15, 10, 12.5)), edge_mm=4.3)
    points, area = skin_quadrature(mesh)
    loads = np.zeros((len(FORCES_N_PER_MPA), *mesh.nodes_mm.shape))
    for side, place in ((1.0, (30.0, 2.0, 1.0)), (-1.0, (-30.0, 1.0, -1.0))):
        for k, force in enumerate(FORCES_N_PER_MPA):
            away = np.linalg.norm(points.point_mm - np.array(place), axis=1)
            share = np.maximum(1 - (away / (4 + 0.1 * force)) ** 2, 0) * area
            push = -side * force * (share / share.sum())[:, None] * [1.0, -0.05, 0.0]
            loads[k] += points.point_load(push[None])[0]
    print(f"{mesh.nodes_mm.size} dofs")
    print("nu    tolerance  factor s  level s  iterations              beyond linear, %")
    for poisson_ratio in (0.45, 0.49):
        start = time.process_time()
        solid = UnitModulusSolid.factorise(mesh, poisson_ratio=poisson_ratio, support="free")
        factor_s = time.process_time() - start
        finite = FiniteStrainSolid(solid=solid, law=NeoHookean(poisson_ratio=poisson_ratio))
        finite.displacement(loads[:1])  # what all loads share
        linear = solid.displacement(loads)
        for tolerance in (1e-7, 1e-5):
            start = time.process_time()
            found = finite.displacement(loads, tolerance=tolerance)
            level_s = (time.process_time() - start) / len(loads)
            beyond = np.linalg.norm(found.displacement - linear, axis=(1, 2))
            beyond /= np.linalg.norm(linear, axis=(1, 2))
            percent = " ".join(f"{100 * b:.1f}" for b in beyond)
            print(
                f"{poisson_ratio:.2f}  {tolerance:.0e}      {factor_s:5.1f}     {level_s:5.2f}    "
                f"{found.iterations!s:22s}  {percent}"
            )


if __name__ == "__main__":
    main()
