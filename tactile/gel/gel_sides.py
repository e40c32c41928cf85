"""Change of a gel's compliance by its sides and a domed face: a finite block minus an infinite slab.

Both have the same quadratic bricks (27 nodes), fixed at the back. Bricks as coarse as half the gel's
thickness err near a load, but equally in both, so the error cancels. The difference is smooth at a brick or
more from the sides. It is added to the infinite slab's exact response (tactile.gel.slab).

The block's face is z = -x^2 / (2 R_x) - y^2 / (2 R_y) about its middle, its back z = -h. Isoparametric bricks
follow the face. Symmetry splits the block into four independent problems, even or odd in x and y. The slab
needs one column of bricks for each wave vector (Bloch), on a lattice that repeats CLEAR_CELLS beyond the gel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import block_diag, coo_array, csr_array, kron

PER_THICKNESS, LAYERS = 2.0, 2
"""Bricks per thickness along the face, and through it: the effect of sides is within 2 % of that on a fine
mesh (`tests/tactile/test_gel_slab.py`)."""
LEAST_CELLS, MOST_CELLS = 4, 14
"""Fewest and most bricks along a side: beyond seven thicknesses they are wider. Set by hand, for time."""
CLEAR_CELLS = 12
"""Bricks between a gel and its next image in the infinite slab: six thicknesses."""
MOST_NU = 0.495
"""Largest Poisson's ratio of the bricks, which are inaccurate nearer to 0.5. Set by hand."""

GelSides: TypeAlias = Literal["free", "bonded"]
SIDES: tuple[GelSides, ...] = ("free", "bonded")
"""Conditions at the sides of a gel."""


class GelOutline(NamedTuple):
    """A rectangular gel: size along x and y, its middle in the pad frame, and the condition at its sides.

    Sides are `free`, or `bonded` to a frame as stiff as the back. `face_radius_mm`: radii of a domed face
    along x and y, infinite if it is flat; the thickness of a domed gel is that in the middle.
    """

    size_mm: tuple[float, float]
    centre_mm: tuple[float, float] = (0.0, 0.0)
    sides: GelSides = "free"
    face_radius_mm: tuple[float, float] = (np.inf, np.inf)

    @property
    def domed(self) -> bool:
        """Whether the face is curved."""
        return not np.isinf(self.face_radius_mm).all()

    @property
    def lowest_mm(self) -> float:
        """Depth of the face's corners below its middle, mm."""
        return float(
            sum(size**2 / (8 * r) for size, r in zip(self.size_mm, self.face_radius_mm, strict=True))
        )

    def face_mm(
        self, x_mm: Float[np.ndarray, "*n"], y_mm: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Height of the untouched face, mm: 0 in its middle, negative elsewhere on a dome."""
        (x0, y0), (along, across) = self.centre_mm, self.face_radius_mm
        return np.asarray(-((x_mm - x0) ** 2) / (2 * along) - (y_mm - y0) ** 2 / (2 * across))


@dataclass(frozen=True, kw_only=True)
class SideResponse:
    """Block minus slab, mm MPa per N, between nodes of the face's lattice: x slowest, y, component."""

    x_mm: Float[np.ndarray, " a"]
    y_mm: Float[np.ndarray, " b"]
    difference: Float[np.ndarray, "c c"]

    def between(
        self, at_mm: Float[np.ndarray, "n 2"], nodes_mm: Float[np.ndarray, "m 2"], *, pitch_mm: float
    ) -> Float[np.ndarray, "n 3 m 3"]:
        """Displacement (mm) at points per newton on tents around nodes (tactile.gel.slab), for E = 1 MPa.

        Points beyond the gel move like its nearest edge. The part of a tent beyond the gel carries no load.
        """
        lattice = (self.x_mm, self.y_mm)
        read = _outer(*(_values(line, at_mm[:, k]) for k, line in enumerate(lattice)))
        load = _outer(*(_tents(line, nodes_mm[:, k], pitch_mm) for k, line in enumerate(lattice)))
        size = read.shape[1]
        half = np.tensordot(read, self.difference.reshape(size, 3, size, 3), axes=(1, 0))
        return np.asarray(np.moveaxis(np.tensordot(half, load, axes=(2, 1)), 3, 2))


@lru_cache(maxsize=8)
def side_response(thickness_mm: float, nu: float, outline: GelOutline) -> SideResponse:
    """Response of a gel of E = 1 MPa with sides and a domed face minus that of an infinite flat one."""
    nu = min(nu, MOST_NU)
    per_mm = PER_THICKNESS / thickness_mm
    cells = [int(np.clip(np.ceil(per_mm * size), LEAST_CELLS, MOST_CELLS)) for size in outline.size_mm]
    across = [size / count for size, count in zip(outline.size_mm, cells, strict=True)]
    x_mm, y_mm = (
        middle + size * (np.arange(2 * count + 1) / 2 - count / 2)
        for middle, size, count in zip(outline.centre_mm, across, cells, strict=True)
    )
    finite = face_compliance(
        x_mm,
        y_mm,
        thickness_mm=thickness_mm,
        face_mm=outline.face_mm(*np.meshgrid(x_mm, y_mm, indexing="ij")),
        nu=nu,
        bonded=outline.sides == "bonded",
    )
    return SideResponse(x_mm=x_mm, y_mm=y_mm, difference=finite - _endless(cells, across, thickness_mm, nu))


def face_compliance(
    x_mm: Float[np.ndarray, " a"],
    y_mm: Float[np.ndarray, " b"],
    *,
    thickness_mm: float,
    face_mm: Float[np.ndarray, "a b"],
    nu: float,
    bonded: bool,
) -> Float[np.ndarray, "c c"]:
    """Displacement (mm) of the face's nodes per newton on them, E = 1 MPa: x slowest, y, component.

    `x_mm`, `y_mm`: places of the nodes, two per brick, symmetric about the middle; `bonded`: fixed sides.
    `face_mm`: height of the face at the nodes, 0 in the middle.
    """
    parted = [_even_and_odd(len(line), bonded=bonded) for line in (x_mm, y_mm)]
    levels = np.linspace(0.0, 1.0, 2 * LAYERS + 1)
    height = -thickness_mm + levels * (thickness_mm + face_mm)[..., None]
    places = np.stack(np.broadcast_arrays(x_mm[:, None, None], y_mm[:, None], height), axis=-1)
    stiffness = _brick_stiffness(places, nu)
    a, b, up = places.shape[:3]
    above = csr_array(np.eye(up)[:, 1:])
    nodal_compliance = np.zeros((a, b, 3, a, b, 3))
    for parity in product((0, 1), repeat=2):
        bases = [
            [csr_array(parted[axis][p ^ (i == axis)]) for i in range(3)] for axis, p in enumerate(parity)
        ]
        motion = [kron(kron(bases[0][i], bases[1][i]), above) for i in range(3)]
        motions = block_diag(motion, format="csr")
        small = (motions.T @ stiffness @ motions).toarray()
        ends = np.cumsum([0, *(part.shape[1] for part in motion)])
        top = np.concatenate([np.arange(end + up - 2, stop, up - 1) for end, stop in pairwise(ends)])
        loads = np.eye(len(small))[:, top]
        compliance = cho_solve(cho_factor(small, lower=True), loads)[top]
        face = np.cumsum([0, *(part.shape[1] // (up - 1) for part in motion)])
        for i, j in product(range(3), repeat=2):
            left, right = (kron(bases[0][k], bases[1][k]).toarray() for k in (i, j))
            block = compliance[face[i] : face[i + 1], face[j] : face[j + 1]]
            nodal_compliance[:, :, i, :, :, j] += (left @ block @ right.T).reshape(a, b, a, b)
    return np.asarray(nodal_compliance.reshape(3 * a * b, -1))


def _brick_stiffness(places: Float[np.ndarray, "a b u 3"], nu: float) -> csr_array:
    """Stiffness matrix for E = 1 MPa; unknowns: component, then node (x slowest, then y, then z)."""
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


def _endless(
    cells: Sequence[int], across: Sequence[float], thickness_mm: float, nu: float
) -> Float[np.ndarray, "c c"]:
    """Compliance of an infinite slab between the same nodes, mm MPa per N."""
    x, y = (size * np.arange(3) / 2 for size in across)
    up = np.linspace(-thickness_mm, 0.0, 2 * LAYERS + 1)
    column = _brick_stiffness(np.stack(np.meshgrid(x, y, up, indexing="ij"), axis=-1), nu).toarray()
    above = column.reshape(3, 3, 3, len(up), 3, 3, 3, len(up))[:, :, :, 1:, :, :, :, 1:]
    motions = []
    for count in cells:
        motion = np.zeros((count + CLEAR_CELLS, 3, 2), dtype=complex)
        motion[:, 0, 0] = motion[:, 1, 1] = 1.0
        motion[:, 2, 0] = np.exp(2j * np.pi * np.fft.fftfreq(len(motion)))
        motions.append(motion)
    along, over = motions
    tests = np.conj(along), np.conj(over)
    stiffness = np.einsum("iklujmnw,pka,qlb,pmc,qnd->pqiuabjwcd", above, *tests, *motions, optimize=True)
    waves, unknowns = stiffness.shape[:2], 12 * (len(up) - 1)
    inverse = np.linalg.inv(stiffness.reshape(*waves, unknowns, unknowns)).reshape(stiffness.shape)
    by_cell = np.real(np.fft.ifft2(inverse[:, :, :, -1, :, :, :, -1], axes=(0, 1)))
    cell, kind = zip(*(np.divmod(np.arange(2 * count + 1), 2) for count in cells), strict=True)
    apart = [index[:, None] - index for index in cell]
    compliance = by_cell[
        apart[0][:, None, :, None], apart[1][None, :, None, :], :,
        kind[0][:, None, None, None], kind[1][:, None, None], :,
        kind[0][:, None], kind[1],
    ]  # fmt: skip
    size = 3 * len(kind[0]) * len(kind[1])
    return np.ascontiguousarray(compliance.transpose(0, 1, 4, 2, 3, 5)).reshape(size, size)


def _even_and_odd(nodes: int, *, bonded: bool) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal even and odd motions of a line of nodes; bonded ends do not move."""
    unit = np.eye(nodes)
    half = unit[:, int(bonded) : nodes // 2]
    even = np.column_stack([(half + half[::-1]) / np.sqrt(2), unit[:, nodes // 2]])
    return even, (half - half[::-1]) / np.sqrt(2)


def _values(line_mm: Float[np.ndarray, " a"], at_mm: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n a"]:
    """The line's quadratic shape functions at points; a point beyond an end has the values of that end."""
    size = line_mm[2] - line_mm[0]
    place = np.clip((at_mm - line_mm[0]) / size, 0.0, len(line_mm) // 2)
    cell = np.minimum(place.astype(int), len(line_mm) // 2 - 1)
    s = 2 * (place - cell) - 1
    shape_functions = np.zeros((len(at_mm), len(line_mm)))
    for offset, value in enumerate((s * (s - 1) / 2, 1 - s * s, s * (s + 1) / 2)):
        shape_functions[np.arange(len(at_mm)), 2 * cell + offset] = value
    return shape_functions


def _tents(
    line_mm: Float[np.ndarray, " a"], centre_mm: Float[np.ndarray, " m"], pitch_mm: float
) -> Float[np.ndarray, "m a"]:
    """Nodal shares of a newton spread as (1 - |x - c| / pitch) / pitch; parts beyond the line are lost."""
    points, weights = np.polynomial.legendre.leggauss(4)
    arm = np.concatenate([points - 1, points + 1]) / 2
    share = (1 - np.abs(arm)) * np.tile(weights, 2) / 2
    at = centre_mm[:, None] + pitch_mm * arm
    inside = (at >= line_mm[0]) & (at <= line_mm[-1])
    read = _values(line_mm, at.ravel()).reshape(*at.shape, -1)
    return np.asarray(np.einsum("mp,mpa->ma", share * inside, read))


def _outer(x: Float[np.ndarray, "n a"], y: Float[np.ndarray, "n b"]) -> Float[np.ndarray, "n ab"]:
    return np.asarray((x[:, :, None] * y[:, None]).reshape(len(x), -1))
