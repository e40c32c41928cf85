"""Flesh that hardly changes its volume, without locking: one change of volume per element.

Where nu nears 1/2 the term lambda (div u)^2 forces div u to vanish at every point, more than a T10 element's
displacements can do and still bend. Here it acts on the element's mean of div u alone,

    K_lambda:  sum over elements of  (integral of div u) (integral of div v) / volume,

the element P2/P0 with its pressure eliminated: stable, exact for even strain, and as sparse as K_mu. Its
compliance is no longer too small for certain: it may err to either side. Measured (2026-11-20,
benchmarks/convergence.py) on presses of a cored 30 mm cube and two grasps with default meshes: energy off by
-1.3 to +0.9 %; T10 with pointwise dilatation by -0.8 to -3.1 % (nu .45) and -1.4 to -5.2 % (.49).
Source: Boffi, Brezzi and Fortin, "Mixed Finite Element Methods and Applications", 2013, chapter 8; Nagtegaal,
Parks and Rice, Computer Methods in Applied Mechanics and Engineering 4, 1974.
"""

import numpy as np
from jaxtyping import Float, Int

from fem.assembly import Stiffness
from fem.element_gradients import inverse_3x3
from fem.element_pattern import ElementPattern
from fem.elements import t10_gradient, tet_quadrature


def with_mean_dilatation(
    parts: Stiffness, nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]
) -> Stiffness:
    """The stiffness parts of fem.assembly.assemble with K_lambda on element means; K_mu stays."""
    points, weights = tet_quadrature()
    reference = t10_gradient(points)
    x = nodes_mm[tets]
    jacobian = (reference.reshape(-1, 10) @ x).reshape(len(x), len(weights), 3, 3).transpose(2, 3, 0, 1)
    inverse, det = inverse_3x3(jacobian)
    measure = det * weights
    outflow = np.einsum("mq,ikmq,qkn->imn", measure, inverse, reference, optimize=True)
    outflow /= np.sqrt(measure.sum(axis=1))[:, None]
    pattern = ElementPattern.of(tets, len(nodes_mm))
    blocks = np.empty((len(pattern.indices), 3, 3))
    for i in range(3):
        for j in range(3):
            product = outflow[i][:, :, None] * outflow[j][:, None, :]
            blocks[:, i, j] = pattern.gather @ product.reshape(-1)
    return Stiffness(parts.k_mu, pattern.blocks(blocks))
