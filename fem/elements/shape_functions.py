"""Quadratic shape functions of the tetrahedron (T10) and the triangle (T6), and their quadrature.

Node order: corners first, then mid-edges. T10: 01, 12, 20, 03, 13, 23. T6: 01, 12, 20.
Reference coordinates are the barycentric ones without the first: corner 0 sits at the origin.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

TET_EDGES: Int[np.ndarray, "6 2"] = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])
"""Corners at the ends of mid-edge nodes 4 to 9: the order named above."""
TRI_EDGES: Int[np.ndarray, "3 2"] = np.array([[0, 1], [1, 2], [2, 0]])
"""Likewise of mid-edge nodes 3 to 5."""
#: the four faces of a T10 as T6, their normals pointing out of a positively oriented element
TET_FACES: Int[np.ndarray, "4 6"] = np.array(
    [[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [2, 0, 3, 6, 7, 9]]
)


def _quadratic(
    barycentric: Float[np.ndarray, "q b"], edges: Int[np.ndarray, "e 2"]
) -> Float[np.ndarray, "q n"]:
    """Values: L(2L - 1) at corners, 4 Li Lj at mid-edges."""
    i, j = edges.T
    return np.hstack([barycentric * (2 * barycentric - 1), 4 * barycentric[:, i] * barycentric[:, j]])


def _quadratic_gradient(
    barycentric: Float[np.ndarray, "q b"], edges: Int[np.ndarray, "e 2"]
) -> Float[np.ndarray, "q d n"]:
    """Derivatives of `_quadratic` to the reference coordinates (L0 = 1 - the others)."""
    d = barycentric.shape[1] - 1
    slope = np.vstack([-np.ones(d), np.eye(d)])  # dL/dxi: (b, d)
    i, j = edges.T
    corner = (4 * barycentric - 1)[:, None, :] * slope.T
    middle = 4 * (barycentric[:, None, i] * slope[j].T + barycentric[:, None, j] * slope[i].T)
    return np.concatenate([corner, middle], axis=2)


def barycentric(reference: Float[np.ndarray, "q d"]) -> Float[np.ndarray, "q b"]:
    """All barycentric coordinates from the reference ones: the first is what is left to one.

    >>> barycentric(np.array([[0.25, 0.5, 0.125]]))
    array([[0.125, 0.25 , 0.5  , 0.125]])
    """
    return np.hstack([1 - reference.sum(axis=1, keepdims=True), reference])


def t10_shape(reference: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 10"]:
    """Values of the ten shape functions of the tetrahedron.

    They add up to 1; at a corner one function is 1 and the others are 0.

    >>> t10_shape(np.array([[1.0, 0, 0], [0.1, 0.2, 0.3]])).sum(axis=1).round(12)
    array([1., 1.])
    """
    return _quadratic(barycentric(reference), TET_EDGES)


def t10_gradient(reference: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 3 10"]:
    """Derivatives of the ten shape functions to the reference coordinates."""
    return _quadratic_gradient(barycentric(reference), TET_EDGES)


def t6_shape(reference: Float[np.ndarray, "q 2"]) -> Float[np.ndarray, "q 6"]:
    """Values of the six shape functions of the triangle."""
    return _quadratic(barycentric(reference), TRI_EDGES)


def t6_gradient(reference: Float[np.ndarray, "q 2"]) -> Float[np.ndarray, "q 2 6"]:
    """Derivatives of the six shape functions to the reference coordinates."""
    return _quadratic_gradient(barycentric(reference), TRI_EDGES)


def tet_quadrature(
    degree: Literal[2, 5] = 5,
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Points and weights, exact to this degree on the reference tetrahedron (volume 1/6); weights positive.

    Source: the 14-point rule of Walkington, "Quadrature on simplices of arbitrary dimension", 2000; the
    4-point rule of Hammer, Marlowe and Stroud, "Numerical integration over simplexes and cones", 1956.

    The integral of x over the reference tetrahedron is 1/24.

    >>> points, weights = tet_quadrature()
    >>> round(24 * float(weights @ points[:, 0]), 12)
    1.0
    """
    if degree == 2:
        a = (5 - np.sqrt(5)) / 20
        return a + (1 - 4 * a) * np.eye(4)[:, 1:], np.full(4, 1 / 24)
    unit = np.eye(4)
    corners = [a + (1 - 4 * a) * unit for a in (0.3108859192633006, 0.0927352503108912)]
    a = 0.0455037041256496
    middles = a + (0.5 - 2 * a) * unit[TET_EDGES].sum(axis=1)
    weights = np.repeat([0.1126879257180159, 0.0734930431163619, 0.0425460207770815], [4, 4, 6])
    return np.vstack([*corners, middles])[:, 1:], weights / weights.sum() / 6


def tri_quadrature() -> tuple[Float[np.ndarray, "7 2"], Float[np.ndarray, "7"]]:
    """Points and weights, exact to degree 5 on the reference triangle (area 1/2).

    Source: Radon, "Zur mechanischen Kubatur", Monatshefte für Mathematik 52, 1948: the seven-point rule.

    The integral of x over the reference triangle is 1/6.

    >>> points, weights = tri_quadrature()
    >>> round(6 * float(weights @ points[:, 0]), 12)
    1.0
    """
    root = np.sqrt(15.0)
    corners = [a + (1 - 3 * a) * np.eye(3) for a in ((6 - root) / 21, (6 + root) / 21)]
    weights = np.repeat([9 / 40, (155 - root) / 1200, (155 + root) / 1200], [1, 3, 3])
    return np.vstack([np.full(3, 1 / 3), *corners])[:, 1:], weights / 2
