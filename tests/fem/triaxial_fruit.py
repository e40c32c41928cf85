"""A triaxial fruit round a rigid pit between two flat tools, by the repository's tetrahedra at small strain.

Another discretisation, another solver and a shape without an axis: the truth for curves that are tabulated by
axisymmetric elements. Contact is node-wise and frictionless: pressures of one sign that close every gap,
min q' C q / 2 - q' g, q >= 0, on the compliance C of the nodes that can touch.
"""

import numpy as np
from fem_shapes import ball
from scipy.optimize import nnls

from fem.elements.assembly import assemble
from fem.mesh.flesh_mesh import tetrahedralise
from fem.sparse.solver import factorise


def force_between(semi_axes_mm, *, pit_share, nu, squeeze, edge_mm=1.0):
    """N for E = 1 MPa, tools along z; the pit, of the fruit's shape, stays in the middle between them."""
    semi = np.asarray(semi_axes_mm)
    fruit, pit = ball(6000, semi_axes_mm=semi), ball(1200, semi_axes_mm=pit_share * semi)
    poles = np.array([[0, 0, semi[2]], [0, 0, -semi[2]]])
    mesh = tetrahedralise(
        *fruit,
        *pit,
        edge_mm=5.0,
        refine_at_mm=poles,
        refine_radius_mm=6.0 * edge_mm,
        refine_edge_mm=edge_mm,
        dof_limit=45_000,
    )
    stiffness = assemble(mesh.nodes_mm, mesh.tets).for_unit_modulus(poisson_ratio=nu)
    moves = np.ones(stiffness.shape[0], dtype=bool)
    moves[(3 * mesh.pit_nodes[:, None] + np.arange(3)).ravel()] = False
    free = np.flatnonzero(moves)
    skin, each = mesh.outer_nodes, squeeze * semi[2]
    height = mesh.nodes_mm[skin, 2]
    near = skin[np.abs(height) > semi[2] - 1.1 * each]
    side = np.sign(mesh.nodes_mm[near, 2])
    dof = np.searchsorted(free, 3 * near + 2)
    load = np.zeros((len(free), len(near)))
    load[dof, np.arange(len(near))] = -side
    compliance = -side[:, None] * factorise(stiffness[free][:, free]).solve(load)[dof]
    gap = each - (semi[2] - np.abs(mesh.nodes_mm[near, 2]))
    root = np.linalg.cholesky((compliance + compliance.T) / 2)
    pressed, _ = nnls(root.T, np.linalg.solve(root, gap), maxiter=20_000)
    return float(pressed.sum() / 2)
