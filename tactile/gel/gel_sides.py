"""What the sides of a gel change in how its face gives way: a finite block less an endless slab.

Both are meshed with the same quadratic bricks (27 nodes) whose back is fixed. Bricks as coarse as half the
gel's thickness err beside a load, but in both by the same, which goes out in the difference; that is
smooth, a brick or more from the sides, and is added to the endless slab's exact response
(tactile.gel.slab). The stiffness of bricks on a lattice is a sum of Kronecker products of quadratic elements
on lines,

    K_ij = lambda A(i, j) + mu (A(j, i) + delta_ij sum_k A(k, k)),    A(a, b) = int d_a v_i d_b u_j,

taken for the block in its four classes of even and odd motion, and for the endless slab one wave vector at a
time (Bloch), on a lattice that repeats itself CLEAR_CELLS beyond the gel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from tactile.gel.domed_bricks import domed_face_compliance

PER_THICKNESS, LAYERS = 2.0, 2
"""Bricks per thickness along the face, and through it: within 2 % of what a fine mesh says that the sides
change (`tests/tactile/test_gel_sides.py`)."""
LEAST_CELLS, MOST_CELLS = 4, 14
"""Bricks along a side: a gel wider than seven thicknesses has wider ones. Set by hand, for the time."""
CLEAR_CELLS = 12
"""Bricks between a gel and its next image in the endless slab: six thicknesses."""
MOST_NU = 0.495
"""Bricks are no good nearer to 0.5. Set by hand."""

GelSides: TypeAlias = Literal["free", "bonded"]
SIDES: tuple[GelSides, ...] = ("free", "bonded")
"""What the sides of a gel may be."""
Line: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""int v u, int v' u' and int v' u of the nodes along one axis."""
Bases: TypeAlias = Sequence[np.ndarray]
"""By component: its motions along one axis at that axis's nodes, (batch, nodes, motions)."""


class GelOutline(NamedTuple):
    """A rectangular gel: size along x and y, its middle in the pad frame, and what its sides do.

    Sides are `free`, or `bonded` to a frame as stiff as the back. `face_radius_mm`: radii of a domed face
    along x and y, infinite where it is flat; the thickness is then that in its middle.
    """

    size_mm: tuple[float, float]
    centre_mm: tuple[float, float] = (0.0, 0.0)
    sides: GelSides = "free"
    face_radius_mm: tuple[float, float] = (np.inf, np.inf)

    @property
    def domed(self) -> bool:
        """Whether its face is no plane."""
        return not np.isinf(self.face_radius_mm).all()

    @property
    def lowest_mm(self) -> float:
        """How far the face's corners lie below its middle."""
        return float(
            sum(size**2 / (8 * r) for size, r in zip(self.size_mm, self.face_radius_mm, strict=True))
        )

    def face_mm(
        self, x_mm: Float[np.ndarray, "*n"], y_mm: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Height of the untouched face, mm: 0 in its middle, negative beside it."""
        (x0, y0), (along, across) = self.centre_mm, self.face_radius_mm
        return np.asarray(-((x_mm - x0) ** 2) / (2 * along) - (y_mm - y0) ** 2 / (2 * across))


@dataclass(frozen=True, kw_only=True)
class SideResponse:
    """The difference, mm MPa per N, between nodes of the face's lattice: x slowest, y, component."""

    x_mm: Float[np.ndarray, " a"]
    y_mm: Float[np.ndarray, " b"]
    difference: Float[np.ndarray, "c c"]

    def between(
        self, at_mm: Float[np.ndarray, "n 2"], nodes_mm: Float[np.ndarray, "m 2"], *, pitch_mm: float
    ) -> Float[np.ndarray, "n 3 m 3"]:
        """Of E = 1 MPa: displacement (mm) at points per newton on tents round nodes (tactile.gel.slab).

        Points beyond the gel move as its nearest edge does; what of a tent lies beyond it counts for nothing.
        """
        lattice = (self.x_mm, self.y_mm)
        read = _outer(*(_values(line, at_mm[:, k]) for k, line in enumerate(lattice)))
        load = _outer(*(_tents(line, nodes_mm[:, k], pitch_mm) for k, line in enumerate(lattice)))
        size = read.shape[1]
        half = np.tensordot(read, self.difference.reshape(size, 3, size, 3), axes=(1, 0))
        return np.asarray(np.moveaxis(np.tensordot(half, load, axes=(2, 1)), 3, 2))


@lru_cache(maxsize=8)
def side_response(thickness_mm: float, nu: float, outline: GelOutline) -> SideResponse:
    """The response of a gel of E = 1 MPa with sides and a domed face less that of an endless flat one."""
    nu = min(nu, MOST_NU)
    per_mm = PER_THICKNESS / thickness_mm
    cells = [int(np.clip(np.ceil(per_mm * size), LEAST_CELLS, MOST_CELLS)) for size in outline.size_mm]
    across = [size / count for size, count in zip(outline.size_mm, cells, strict=True)]
    through = _line(LAYERS, thickness_mm / LAYERS)
    bonded = outline.sides == "bonded"
    x_mm, y_mm = (
        middle + size * (np.arange(2 * count + 1) / 2 - count / 2)
        for middle, size, count in zip(outline.centre_mm, across, cells, strict=True)
    )
    if outline.domed:
        finite = domed_face_compliance(
            x_mm,
            y_mm,
            thickness_mm=thickness_mm,
            layers=LAYERS,
            face_mm=outline.face_mm(*np.meshgrid(x_mm, y_mm, indexing="ij")),
            nu=nu,
            parted=[_even_and_odd(2 * count + 1, bonded=bonded) for count in cells],
        )
    else:
        finite = _finite(cells, across, through, nu, bonded=bonded)
    return SideResponse(x_mm=x_mm, y_mm=y_mm, difference=finite - _endless(cells, across, through, nu))


def _finite(
    cells: Sequence[int], across: Sequence[float], through: Line, nu: float, *, bonded: bool
) -> Float[np.ndarray, "c c"]:
    """Compliance of the block's face, by the parity of its normal motion in x and in y."""
    lines = [_line(count, size) for count, size in zip(cells, across, strict=True)]
    parted = [_even_and_odd(2 * count + 1, bonded=bonded) for count in cells]
    nodes = [2 * count + 1 for count in cells]
    found = np.zeros((*nodes, 3, *nodes, 3))
    for parity in product((0, 1), repeat=2):
        # d/dx turns even into odd: a motion along x has the other parity in x than one along z
        bases = [[parted[axis][p ^ (i == axis)][None] for i in range(3)] for axis, p in enumerate(parity)]
        stiffness, top = _stiffness(lines, bases, through, nu)
        loads = np.eye(len(stiffness[0, 0]))[:, top]
        compliance = cho_solve(cho_factor(stiffness[0, 0], lower=True), loads)[top]
        ends = np.cumsum([0, *(bases[0][i].shape[2] * bases[1][i].shape[2] for i in range(3))])
        for i, j in product(range(3), repeat=2):
            own = compliance[ends[i] : ends[i + 1], ends[j] : ends[j + 1]]
            left, right = (np.kron(bases[0][k][0], bases[1][k][0]) for k in (i, j))
            found[:, :, i, :, :, j] += (left @ own @ right.T).reshape(*nodes, *nodes)
    return np.asarray(found.reshape(3 * nodes[0] * nodes[1], -1))


def _endless(
    cells: Sequence[int], across: Sequence[float], through: Line, nu: float
) -> Float[np.ndarray, "c c"]:
    """Compliance between the same nodes of a slab that goes on."""
    lines, bases = [_line(1, size) for size in across], []
    for count in cells:
        phase = np.exp(2j * np.pi * np.fft.fftfreq(count + CLEAR_CELLS))
        motion = np.zeros((len(phase), 3, 2), dtype=complex)
        motion[:, 0, 0] = motion[:, 1, 1] = 1.0
        motion[:, 2, 0] = phase
        bases.append([motion] * 3)
    stiffness, top = _stiffness(lines, bases, through, nu)
    by_wave = np.linalg.inv(stiffness)[..., top[:, None], top]
    by_cell = np.real(np.fft.ifft2(by_wave, axes=(0, 1))).reshape(*by_wave.shape[:2], 3, 2, 2, 3, 2, 2)
    cell, kind = zip(*(np.divmod(np.arange(2 * count + 1), 2) for count in cells), strict=True)
    apart = [own[:, None] - own for own in cell]
    found = by_cell[
        apart[0][:, None, :, None], apart[1][None, :, None, :], :,
        kind[0][:, None, None, None], kind[1][:, None, None], :,
        kind[0][:, None], kind[1],
    ]  # fmt: skip
    size = 3 * len(kind[0]) * len(kind[1])
    return np.ascontiguousarray(found.transpose(0, 1, 4, 2, 3, 5)).reshape(size, size)


def _stiffness(
    lines: Sequence[Line], bases: Sequence[Bases], through: Line, nu: float
) -> tuple[np.ndarray, np.ndarray]:
    """K of E = 1 MPa, (batch in x, batch in y, d, d), of what is above the back; and which unknowns are of
    the face. Unknowns: component, node through the gel, motion along x, motion along y.
    """
    lame, mu = nu / ((1 + nu) * (1 - 2 * nu)), 1 / (2 * (1 + nu))
    above = tuple(matrix[1:, 1:] for matrix in through)

    def along(axis: int, i: int, j: int, *, test: bool, trial: bool) -> np.ndarray:
        mass, stiff, slope = above if axis == 2 else lines[axis]
        own = stiff if test and trial else slope if test else slope.T if trial else mass
        return own if axis == 2 else np.conj(bases[axis][i].swapaxes(1, 2)) @ own @ bases[axis][j]

    def product_of(i: int, j: int, a: int, b: int) -> np.ndarray:
        x, y, z = (along(axis, i, j, test=axis == a, trial=axis == b) for axis in range(3))
        found = np.einsum("zw,xij,ykl->xyzikwjl", z, x, y)
        rows = int(np.prod(found.shape[2:5]))
        return np.asarray(found.reshape(*found.shape[:2], rows, -1))

    rows = []
    for i in range(3):
        row = []
        for j in range(3):
            own = lame * product_of(i, j, i, j) + mu * product_of(i, j, j, i)
            for k in range(3) if i == j else ():
                own += mu * product_of(i, i, k, k)
            row.append(own)
        rows.append(np.concatenate(row, axis=-1))
    ends = np.cumsum([own.shape[-2] for own in rows])
    flat = [bases[0][i].shape[2] * bases[1][i].shape[2] for i in range(3)]
    top = np.concatenate([np.arange(end - count, end) for end, count in zip(ends, flat, strict=True)])
    return np.concatenate(rows, axis=-2), top


def _line(cells: int, size_mm: float) -> Line:
    """Quadratic elements of equal size in a row, three nodes each."""
    elements = (
        size_mm / 30 * np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]]),
        np.array([[7.0, -8.0, 1.0], [-8.0, 16.0, -8.0], [1.0, -8.0, 7.0]]) / (3 * size_mm),
        np.array([[-3.0, -4.0, 1.0], [4.0, 0.0, -4.0], [-1.0, 4.0, 3.0]]) / 6,
    )
    mass, stiff, slope = (np.zeros((2 * cells + 1,) * 2) for _ in elements)
    for cell in range(cells):
        at = slice(2 * cell, 2 * cell + 3)
        for whole, element in zip((mass, stiff, slope), elements, strict=True):
            whole[at, at] += element
    return mass, stiff, slope


def _even_and_odd(nodes: int, *, bonded: bool) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal even and odd motions of a line of nodes, whose ends are at rest where they are bonded."""
    unit = np.eye(nodes)
    half = unit[:, int(bonded) : nodes // 2]
    even = np.column_stack([(half + half[::-1]) / np.sqrt(2), unit[:, nodes // 2]])
    return even, (half - half[::-1]) / np.sqrt(2)


def _values(line_mm: Float[np.ndarray, " a"], at_mm: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n a"]:
    """The line's quadratic functions at points, those beyond its ends taken there."""
    size = line_mm[2] - line_mm[0]
    place = np.clip((at_mm - line_mm[0]) / size, 0.0, len(line_mm) // 2)
    cell = np.minimum(place.astype(int), len(line_mm) // 2 - 1)
    s = 2 * (place - cell) - 1
    found = np.zeros((len(at_mm), len(line_mm)))
    for offset, value in enumerate((s * (s - 1) / 2, 1 - s * s, s * (s + 1) / 2)):
        found[np.arange(len(at_mm)), 2 * cell + offset] = value
    return found


def _tents(
    line_mm: Float[np.ndarray, " a"], centre_mm: Float[np.ndarray, " m"], pitch_mm: float
) -> Float[np.ndarray, "m a"]:
    """Shares of a newton on (1 - |x - c| / pitch) / pitch at the line's nodes."""
    points, weights = np.polynomial.legendre.leggauss(4)
    arm = np.concatenate([points - 1, points + 1]) / 2
    share = (1 - np.abs(arm)) * np.tile(weights, 2) / 2
    at = centre_mm[:, None] + pitch_mm * arm
    inside = (at >= line_mm[0]) & (at <= line_mm[-1])
    read = _values(line_mm, at.ravel()).reshape(*at.shape, -1)
    return np.asarray(np.einsum("mp,mpa->ma", share * inside, read))


def _outer(x: Float[np.ndarray, "n a"], y: Float[np.ndarray, "n b"]) -> Float[np.ndarray, "n ab"]:
    return np.asarray((x[:, :, None] * y[:, None]).reshape(len(x), -1))
