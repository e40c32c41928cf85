"""How a gel with a domed face gives way: quadratic bricks that follow the face, its back flat and fixed.

The face of a block is z = -x^2 / (2 R_x) - y^2 / (2 R_y) from its middle, its back z = -h. Bricks are
isoparametric with 27 nodes; the block is taken apart into its four classes of even and odd motion, as the
flat one is (tactile.gel.gel_sides).
"""

from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import block_diag, coo_array, csr_array, kron

Parted = Sequence[tuple[np.ndarray, np.ndarray]]
"""Of x and y: the even and the odd motions of the nodes along that axis."""


def domed_face_compliance(
    x_mm: Float[np.ndarray, " a"],
    y_mm: Float[np.ndarray, " b"],
    *,
    thickness_mm: float,
    layers: int,
    face_mm: Float[np.ndarray, "a b"],
    nu: float,
    parted: Parted,
) -> Float[np.ndarray, "c c"]:
    """Displacement (mm) of the face's nodes per newton on them, E = 1 MPa: x slowest, y, component.

    `x_mm`, `y_mm`: places of the nodes, two to a brick, even about the middle; `face_mm`: height of the face
    at them, 0 in the middle; `parted`: motions that the sides leave (_even_and_odd of tactile.gel.gel_sides).
    """
    levels = np.linspace(0.0, 1.0, 2 * layers + 1)
    height = -thickness_mm + levels * (thickness_mm + face_mm)[..., None]
    places = np.stack(np.broadcast_arrays(x_mm[:, None, None], y_mm[:, None], height), axis=-1)
    stiffness = _stiffness(places, nu)
    a, b, up = places.shape[:3]
    above = csr_array(np.eye(up)[:, 1:])
    found = np.zeros((a, b, 3, a, b, 3))
    for parity in product((0, 1), repeat=2):
        bases = [
            [csr_array(parted[axis][p ^ (i == axis)]) for i in range(3)] for axis, p in enumerate(parity)
        ]
        motion = [kron(kron(bases[0][i], bases[1][i]), above) for i in range(3)]
        own = block_diag(motion, format="csr")
        small = (own.T @ stiffness @ own).toarray()
        ends = np.cumsum([0, *(part.shape[1] for part in motion)])
        top = np.concatenate([np.arange(end + up - 2, stop, up - 1) for end, stop in pairwise(ends)])
        loads = np.eye(len(small))[:, top]
        compliance = cho_solve(cho_factor(small, lower=True), loads)[top]
        face = np.cumsum([0, *(part.shape[1] // (up - 1) for part in motion)])
        for i, j in product(range(3), repeat=2):
            left, right = (kron(bases[0][k], bases[1][k]).toarray() for k in (i, j))
            block = compliance[face[i] : face[i + 1], face[j] : face[j + 1]]
            found[:, :, i, :, :, j] += (left @ block @ right.T).reshape(a, b, a, b)
    return np.asarray(found.reshape(3 * a * b, -1))


def _stiffness(places: Float[np.ndarray, "a b u 3"], nu: float) -> csr_array:
    """K of E = 1 MPa; unknowns: component, then node (x slowest, then y, then up)."""
    number = np.arange(places[..., 0].size).reshape(places.shape[:3])
    corners = number[:-2:2, :-2:2, :-2:2].reshape(-1, 1)
    steps = np.array(
        [i * number[1, 0, 0] + j * number[0, 1, 0] + k for i, j, k in product(range(3), repeat=3)]
    )
    bricks: Int[np.ndarray, "e 27"] = corners + steps
    points, weights = np.polynomial.legendre.leggauss(3)
    value = np.stack([points * (points - 1) / 2, 1 - points**2, points * (points + 1) / 2])
    slope = np.stack([points - 0.5, -2 * points, points + 0.5])
    local = np.stack(
        [
            np.einsum("ip,jq,kr->pqrijk", *(slope if axis == way else value for axis in range(3)))
            for way in range(3)
        ]
    ).reshape(3, 27, 27)
    at = places.reshape(-1, 3)[bricks]
    jacobian = np.einsum("wqn,enx->eqwx", local, at, optimize=True)
    gradient = np.linalg.solve(jacobian, np.broadcast_to(local.swapaxes(0, 1), (len(bricks), 27, 3, 27)))
    volume = np.linalg.det(jacobian) * np.einsum("p,q,r->pqr", *[weights] * 3).ravel()
    lame, mu = nu / ((1 + nu) * (1 - 2 * nu)), 1 / (2 * (1 + nu))
    moment = np.einsum("eq,eqin,eqjm->eijnm", volume, gradient, gradient, optimize=True)
    same = np.einsum("eiinm->enm", moment)
    count = number.size
    rows, columns, entries = [], [], []
    for i, j in product(range(3), repeat=2):
        block = lame * moment[:, i, j] + mu * moment[:, j, i] + (mu * same if i == j else 0.0)
        rows.append(np.broadcast_to((i * count + bricks)[:, :, None], block.shape).ravel())
        columns.append(np.broadcast_to((j * count + bricks)[:, None, :], block.shape).ravel())
        entries.append(block.ravel())
    where = np.concatenate(rows), np.concatenate(columns)
    return csr_array(coo_array((np.concatenate(entries), where), shape=(3 * count, 3 * count)))
