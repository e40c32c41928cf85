"""A gel pad pressed by a rigid ball, as truth for gel images: finite elements, contact and friction.

The gel is a block of 27-node bricks at small strain, with a fixed back and free sides. Contact acts on the
displaced face: a node at distance d from the ball's centre bears the pressure c_n (R - d) if d < R. Its shear
is c_t times its slip on the ball since first touch, at most friction times pressure (Coulomb). Both c are
stiff penalties. Pad frame: the face is z = 0, the gel lies below, z points out. Forces act on the ball, as in
recordings.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.integrate import simpson
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from fem.sparse.solver import Factor, factorise
from samples.brick_flesh import assembled, lame_constants, shape_gradients
from samples.hexahedra import lagrange, with_midpoints
from samples.sample_failure import NotInEquilibrium

SHIPPED_X = (-13.0, -10.5, -8.5, -7.2, *np.arange(-6.2, 6.3, 1.0333333), 7.2, 8.5, 10.5, 13.0)
"""Edges of the block's bricks along x, mm: a gel of 26 x 22 mm, with 1 mm bricks under the ball."""
SHIPPED_Y = (-11.0, -9.2, -8.0, -7.1, *np.arange(-6.2, 6.3, 1.0333333), 7.1, 8.0, 9.2, 11.0)
"""Edges of the bricks along y, mm."""
SHIPPED_DEPTHS = (0.0, 0.18, 0.4, 0.68, 1.0)
"""Boundaries of its four layers over the thickness: layers are thin at the face, where strain is steepest."""
NORMAL_MPA_PER_MM, SHEAR_MPA_PER_MM = 20.0, 8.0
"""Contact penalties, normal and tangential: at 0.05 MPa the gel's face is 2.5 um inside the ball."""


@dataclass(frozen=True, kw_only=True)
class GelBlock:
    """A block of gel: node lines, and compliance (mm/N) from loads on the nodes `reach` to the face's nodes.

    `weights_mm2` holds the area of each of the face's n nodes, x slowest.
    """

    x_mm: Float[np.ndarray, " a"]
    y_mm: Float[np.ndarray, " b"]
    weights_mm2: Float[np.ndarray, " n"]
    reach: Int[np.ndarray, " r"]
    compliance: Float[np.ndarray, "3*n 3*r"]

    @property
    def face_mm(self) -> Float[np.ndarray, "n 2"]:
        """Nodes of the face, x slowest."""
        return np.stack(np.meshgrid(self.x_mm, self.y_mm, indexing="ij"), axis=-1).reshape(-1, 2)

    def at(
        self, values: Float[np.ndarray, "n c"], where_mm: Float[np.ndarray, "m 2"]
    ) -> Float[np.ndarray, "m c"]:
        """Nodal values interpolated at points of the face by the cells' biquadratic functions."""
        grid = values.reshape(len(self.x_mm), len(self.y_mm), -1)
        (i, a), (j, b) = _read(self.x_mm, where_mm[:, 0]), _read(self.y_mm, where_mm[:, 1])
        near = grid[i[:, :, None], j[:, None, :]]
        return np.asarray(np.einsum("mp,mq,mpqc->mc", a, b, near))


@dataclass(frozen=True, kw_only=True)
class BallPose:
    """Pose of the ball: its centre (pad frame) and its rotation about z since the start."""

    centre_mm: tuple[float, float, float]
    turn_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """The gel's face at one instant: displacement of its nodes and force on the ball, node by node."""

    displacement_mm: Float[np.ndarray, "n 3"]
    force_N: Float[np.ndarray, "n 3"]


def gel_block(
    *,
    thickness_mm: float,
    E_MPa: float,
    nu: float,
    reach_mm: float,
    x_mm: Sequence[float] = SHIPPED_X,
    y_mm: Sequence[float] = SHIPPED_Y,
    depths: Sequence[float] = SHIPPED_DEPTHS,
) -> GelBlock:
    """Mesh and condense a block. `depths`: layer boundaries (relative); `reach_mm`: radius of the loads."""
    x, y = with_midpoints(np.asarray(x_mm)), with_midpoints(np.asarray(y_mm))
    z = -thickness_mm * with_midpoints(np.asarray(depths))[::-1]
    a, b, c = len(x), len(y), len(z)
    number = np.arange(a * b * c).reshape(c, a, b)
    cells = np.lib.stride_tricks.sliding_window_view(number, (3, 3, 3))[::2, ::2, ::2].reshape(-1, 27)
    grid = np.meshgrid(z, x, y, indexing="ij")
    nodes = np.stack([grid[1], grid[2], grid[0]], axis=-1).reshape(-1, 3)
    slopes, volumes = shape_gradients(nodes[cells])
    stiffness = assembled(cells, slopes, volumes, *lame_constants(E_MPa, nu), len(nodes))
    fixed = 3 * a * b
    factor = factorise(csr_array(stiffness[fixed:][:, fixed:]))
    face = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    reach = np.flatnonzero(np.linalg.norm(face, axis=1) < reach_mm)
    top = stiffness.shape[0] - fixed - 3 * a * b
    return GelBlock(
        x_mm=x,
        y_mm=y,
        weights_mm2=np.outer(*(simpson(np.eye(len(line)), x=line) for line in (x, y))).ravel(),
        reach=reach,
        compliance=_columns(factor, top, 3 * a * b, reach),
    )


def pressed(block: GelBlock, path: Sequence[BallPose], *, radius_mm: float, friction: float) -> list[Pressed]:
    """The gel along a path of the ball, instant by instant; the first pose should be without contact.

    Raises NotInEquilibrium if the contact does not converge or grows past the block's reach.
    """
    at = np.column_stack([block.face_mm[block.reach], np.zeros(len(block.reach))])
    weight = block.weights_mm2[block.reach][:, None]
    rows = (3 * block.reach[:, None] + np.arange(3)).ravel()
    small = block.compliance[rows]
    edge = np.linalg.norm(at, axis=1) > np.linalg.norm(at, axis=1).max() - 0.3
    u, touching = np.zeros_like(at), np.zeros(len(at), dtype=bool)
    held = np.zeros_like(at)
    instants = []
    for pose in path:
        turn = Rotation.from_rotvec([0.0, 0.0, pose.turn_rad])
        centre = np.asarray(pose.centre_mm)
        law = _ball_law(at, centre, turn, held, touching, radius_mm, friction)
        u, force = _equilibrium(small, law, weight, u)
        if np.any(force[edge]):
            raise NotInEquilibrium("the ball's contact grew past the part of the gel that can be loaded")
        # a node sticks to a point of the ball, in the ball's frame
        in_ball_mm = turn.inv().apply(at + u - centre)
        now = force[:, 2] / weight[:, 0] < 0
        stretch = _shear(force / weight, at + u - centre) / SHEAR_MPA_PER_MM
        held = np.where(now[:, None], in_ball_mm - turn.inv().apply(stretch), in_ball_mm)
        touching = now
        every = np.zeros((len(block.face_mm), 3))
        every[block.reach] = -force
        shift = (block.compliance @ force.ravel()).reshape(-1, 3)
        instants.append(Pressed(displacement_mm=shift, force_N=every))
    return instants


Law = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def _shear(traction: np.ndarray, arm: np.ndarray) -> np.ndarray:
    normal = arm / np.linalg.norm(arm, axis=1, keepdims=True)
    return np.asarray(traction - (traction * normal).sum(1, keepdims=True) * normal)


def _ball_law(
    at: np.ndarray, centre: np.ndarray, turn: Rotation, held: np.ndarray, touching: np.ndarray,
    radius: float, friction: float,
) -> Law:  # fmt: skip
    """Law: traction on the gel (MPa) at displacement u, and its derivative by finite differences."""
    foot = centre + turn.apply(held)

    def law(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        def load(v: np.ndarray) -> np.ndarray:
            arm = at + v - centre
            distance = np.linalg.norm(arm, axis=1, keepdims=True)
            outward = arm / distance
            pressure = NORMAL_MPA_PER_MM * np.maximum(radius - distance, 0.0)
            drag = np.where(touching[:, None], at + v - foot, 0.0)
            trial = -SHEAR_MPA_PER_MM * (drag - (drag * outward).sum(1, keepdims=True) * outward)
            size = np.maximum(np.linalg.norm(trial, axis=1, keepdims=True), 1e-12)
            return np.asarray(pressure * outward + trial * np.minimum(1.0, friction * pressure / size))

        here, tiny = load(u), 1e-7
        slope = np.stack([(load(u + tiny * e) - here) / tiny for e in np.eye(3)], axis=2)
        return here, slope

    return law


def _equilibrium(
    small: np.ndarray, law: Law, weight: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solve u = C f(u) by Newton with halved steps; the force on the gel, N."""
    for _ in range(80):
        traction, slope = law(u)
        force = traction * weight
        miss = u - (small @ force.ravel()).reshape(-1, 3)
        if np.abs(miss).max() < 1e-8:
            return u, force
        active = np.flatnonzero(np.abs(slope).max(axis=(1, 2)) > 0)
        move = -miss
        if len(active):
            block = (3 * active[:, None] + np.arange(3)).ravel()
            pushed = slope[active] * weight[active][:, :, None]
            part = small[np.ix_(block, block)].reshape(len(block), -1, 3)
            product = np.einsum("anj,njk->ank", part, pushed).reshape(len(block), -1)
            inner = np.linalg.solve(np.eye(len(block)) - product, -miss[active].ravel())
            step = np.einsum("nij,nj->ni", pushed, inner.reshape(-1, 3))
            move = -miss + (small[:, block] @ step.ravel()).reshape(-1, 3)
        best, share = np.linalg.norm(miss), 1.0
        while share > 0.01:
            trial = u + share * move
            left = trial - (small @ (law(trial)[0] * weight).ravel()).reshape(-1, 3)
            if np.linalg.norm(left) < (1 - 0.1 * share) * best:
                break
            share /= 2
        u = trial
    raise NotInEquilibrium(f"the ball's contact did not settle: {np.abs(miss).max():.1e} mm are left")


def _columns(factor: Factor, top: int, size: int, reach: Int[np.ndarray, " r"]) -> Float[np.ndarray, "d 3*r"]:
    dofs = top + (3 * reach[:, None] + np.arange(3)).ravel()
    out = np.empty((size, len(dofs)))
    for part in np.array_split(np.arange(len(dofs)), max(1, len(dofs) // 100)):
        unit = np.zeros((top + size, len(part)))
        unit[dofs[part], np.arange(len(part))] = 1.0
        out[:, part] = factor.solve(unit)[top:]
    return out


def _read(
    x: Float[np.ndarray, " a"], at: Float[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Nodes and weights of a quadratic line element at each point."""
    cell = np.clip(np.searchsorted(x[::2], at) - 1, 0, (len(x) - 3) // 2)
    low, high = x[2 * cell], x[2 * cell + 2]
    value, _ = lagrange(2.0 * (at - low) / (high - low) - 1.0)
    return 2 * cell[:, None] + np.arange(3), value
