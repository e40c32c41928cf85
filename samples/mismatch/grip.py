"""Two pads on a fruit, one instant after the other, each in equilibrium.

The skin nodes that pads can reach have the compliance C: u = freely + C f(u). f holds the gel springs' forces
on the nodes. `freely` is the displacement of unloaded flesh (not zero once it has crept or yielded). Newton's
method solves this, with GMRES for its linear systems.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, gmres

from samples.gel_contact import Gel, traction
from samples.mismatch.gel_bed import (
    Bed,
    Held,
    Link,
    after_step,
    let_go,
    link_of,
    looked_up,
    marker_values,
    nothing_held,
)
from samples.mismatch.meshed_fruit import SkinPatch
from samples.mismatch.skin_compliance import SkinCompliance, Slices, parts_of
from samples.sample_failure import NotInEquilibrium

TOLERANCE_N, ROUGHLY_N = 1e-6, 1e-3
"""Tolerances of the force residual (norm over all nodes), N: six orders below the pads' force of some
newtons. The looser one, three orders below, serves while the skin point of each gel point is unknown."""
ROUNDED_N = 1e-4
"""N: a residual below this that no step reduces is rounding. The compliance has single precision, which
leaves 1e-5 to 3e-5 N after a start that was 40 N off. At the gel's stiffness of 10 N/mm it is 1e-5 mm; it is
more at a first light touch, where the gel is less stiff."""
NEWTON_STEPS = 60
"""Newton steps before a step counts as not converged: three to ten converge if one can (set by hand)."""
LOOKS = 4
"""Most searches for the skin point of each gel point (set by hand)."""
SAME_PLACE_MM = 2e-4
"""mm: a smaller change of places ends the searches; a twentieth of a frame's noise of 4 um
(samples.mismatch.marker_sensor)."""
LEFT_SHARE, GMRES_ROUNDS = 0.01, 100
"""Relative residual of GMRES in a Newton step, and its most iterations (set by hand)."""


@dataclass(frozen=True, kw_only=True)
class InnerContact:
    """Points inside the fruit that push back without friction once they close by more than a gap."""

    gap_mm: float
    N_per_mm: Float[np.ndarray, " p"]

    def push(self, opening_mm: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Force that opens each point, N."""
        return np.asarray(self.N_per_mm * np.maximum(0.0, -(self.gap_mm + opening_mm)))

    def slope(self, opening_mm: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Minus the derivative of the push, N/mm."""
        return np.where(opening_mm < -self.gap_mm, self.N_per_mm, 0.0)


@dataclass(frozen=True, kw_only=True)
class Grip:
    """Constants of a recording: patches, their nodes at rest (fruit frame), beds, gels.

    With an `inner` contact, the unknowns contain the openings of its points after those of the skin.
    """

    patches: tuple[SkinPatch, ...]
    rest_mm: tuple[Float[np.ndarray, "_n 3"], ...]
    beds: tuple[Bed, ...]
    gels: tuple[Gel, Gel]
    inner: InnerContact | None = None

    def local(
        self, side: int, u: Float[np.ndarray, " d"], origins: Float[np.ndarray, "2 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Nodes of one patch in its pad's frame."""
        part = self.part(side)
        here = self.rest_mm[side] + u[part].reshape(-1, 3)
        return np.asarray((here - origins[side]) @ self.patches[side].turn)

    def part(self, side: int) -> slice:
        """Slice of one side's unknowns."""
        first = 0 if side == 0 else 3 * len(self.patches[0].nodes)
        return slice(first, first + 3 * len(self.patches[side].nodes))


@dataclass(frozen=True, kw_only=True)
class Instant:
    """One instant: skin displacement, nodal forces (fruit frame, N), pads' origins, skin points of the gels.

    `step_N`: change of the forces since the previous instant; `travel`: that of the origins.
    """

    u: Float[np.ndarray, " d"]
    step_N: Float[np.ndarray, " d"]
    travel: Float[np.ndarray, "2 3"]
    force_N: Float[np.ndarray, " d"]
    origins: Float[np.ndarray, "2 3"]
    held: tuple[Held, ...]
    marker_shift_mm: tuple[Float[np.ndarray, "m 3"], ...]
    marker_force_N: tuple[Float[np.ndarray, "m 3"], ...]


def before_touch(grip: Grip, origins: Float[np.ndarray, "2 3"], u: Float[np.ndarray, " d"]) -> Instant:
    """An instant without contact; u is the skin's displacement from rest."""
    zero = np.zeros(len(u))
    still = np.zeros((grip.beds[0].markers, 3))
    return Instant(
        u=u, force_N=zero, step_N=zero, travel=np.zeros((2, 3)), origins=origins,
        held=(nothing_held(grip.beds[0]), nothing_held(grip.beds[1])),
        marker_shift_mm=(still, still), marker_force_N=(still, still),
    )  # fmt: skip


def next_instant(
    grip: Grip,
    before: Instant,
    origins: Float[np.ndarray, "2 3"],
    compliance: SkinCompliance,
    freely: Float[np.ndarray, " d"],
    *,
    start: Float[np.ndarray, " d"] | None = None,
    near: Float[np.ndarray, " d"] | None = None,
) -> Instant:
    """The instant with the pads' faces at `origins`. `start`: initial forces; `near`: initial displacement,
    about which the first step takes the gels to be linear. If `freely` moves the whole fruit, initial forces
    alone put the skin far off, and every gel point would appear to slip.

    Raises NotInEquilibrium if Newton's method stalls.
    """
    force = _continued(before, origins) if start is None else start
    columns = _reach(grip, force)
    u = freely + compliance.times(_picked(force, columns), columns) if near is None else near
    was = [grip.local(s, before.u, before.origins) for s in (0, 1)]
    kept_on, look = list(before.held), 0
    while look < LOOKS:
        held = [
            looked_up(grip.beds[s], kept_on[s], grip.patches[s].cells, was[s], grip.local(s, u, origins))
            for s in (0, 1)
        ]
        links = [
            link_of(grip.gels[s], grip.beds[s], held[s], grip.patches[s].cells, len(grip.rest_mm[s]))
            for s in (0, 1)
        ]
        enough = ROUGHLY_N if look == 0 and start is None else TOLERANCE_N
        balance = _balanced(
            grip, links, origins, compliance, freely, force, enough, near if look == 0 else None
        )
        change = np.abs(balance.u - u).max()
        force, u = balance.force_N, balance.u
        lost = [let_go(grip.gels[s], kept_on[s], links[s], grip.local(s, u, origins)) for s in (0, 1)]
        if any(new is not None for new in lost):  # fewer points adhere each time, so this ends
            kept_on = [old if new is None else new for old, new in zip(kept_on, lost, strict=True)]
            look = max(look, 1)
            continue
        look += 1
        if (look > 1 or start is not None) and change < SAME_PLACE_MM:
            break
    now = [grip.local(s, u, origins) for s in (0, 1)]
    if any(np.any(x[p.rim, 2] < 0) for x, p in zip(now, grip.patches, strict=True)):
        raise NotInEquilibrium("the contact patch outgrew the skin that was meshed for it: press less")
    seen = [marker_values(grip.gels[s], grip.beds[s], links[s], now[s]) for s in (0, 1)]
    memory = [
        after_step(grip.gels[s], grip.beds[s], held[s], grip.patches[s].cells, now[s], links[s])
        for s in (0, 1)
    ]
    return Instant(
        u=u, force_N=force, step_N=force - before.force_N, travel=origins - before.origins, origins=origins,
        held=(memory[0], memory[1]),
        marker_shift_mm=(seen[0][0], seen[1][0]), marker_force_N=(seen[0][1], seen[1][1]),
    )  # fmt: skip


def _continued(before: Instant, origins: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, " d"]:
    """Forces extrapolated from the last step by the pads' progress."""
    return np.asarray(before.force_N + going_on(before, origins) * before.step_N)


def going_on(before: Instant, origins: Float[np.ndarray, "2 3"]) -> float:
    """Progress of the pads along the last step, as a share of it: 0 if they turn back, 2 at most."""
    size = float((before.travel**2).sum())
    share = float((before.travel * (origins - before.origins)).sum()) / size if size else 0.0
    return float(np.clip(share, 0.0, 2.0))


@dataclass(frozen=True)
class _State:
    """Assumed forces on the skin, the displacement they cause, and the gels' forces at that displacement."""

    force_N: Float[np.ndarray, " d"]
    u: Float[np.ndarray, " d"]
    push: "_Push"

    @property
    def miss_N(self) -> Float[np.ndarray, " d"]:
        return np.asarray(self.push.force_N - self.force_N)

    @property
    def size_N(self) -> float:
        return float(np.linalg.norm(self.miss_N))


def _balanced(
    grip: Grip, links: list[Link], origins: np.ndarray, compliance: SkinCompliance, freely: np.ndarray,
    start: np.ndarray, enough_N: float, near: np.ndarray | None,
) -> _State:  # fmt: skip
    """Newton's method for the forces. It shortens steps that increase the residual, to 6 % of their length at
    the least. That step counts even if the residual grows; the tolerances decide about the result.
    """

    def state(force: np.ndarray) -> _State:
        columns = _reach(grip, force)
        u = freely + compliance.times(_picked(force, columns), columns)
        return _State(force, u, _Push(grip, links, origins, u))

    now = state(start)
    if near is not None:
        now = state(
            start + _step_from(grip, _Push(grip, links, origins, near), near - now.u, start, compliance)
        )
    for _ in range(NEWTON_STEPS):
        if now.size_N < enough_N:
            return now
        columns = _reach(grip, np.abs(now.force_N) + np.abs(now.push.force_N))
        move = _newton_step(now.miss_N, now.push, columns, compliance)
        for share in (1.0, 0.5, 0.25, 0.125, 0.06):
            trial = state(now.force_N + share * move)
            if trial.size_N < now.size_N:
                break
        else:
            if now.size_N < ROUNDED_N:
                return now
        now = trial
    raise NotInEquilibrium(f"a step of the grip stopped {now.size_N:.1e} N out of balance")


def _step_from(
    grip: Grip, push: "_Push", off: Float[np.ndarray, " d"], force: Float[np.ndarray, " d"],
    compliance: SkinCompliance,
) -> Float[np.ndarray, " d"]:  # fmt: skip
    """The Newton step from `force`, with the gels linear about a displacement that is `off` from the one that
    `force` causes.
    """
    columns = _reach(grip, np.abs(force) + np.abs(push.force_N))
    if not columns:
        return np.zeros_like(force)
    miss = push.force_N - force
    for c, part in parts_of(push.held_by(_picked(off, columns)[:, None], columns)[:, 0], columns):
        miss[c] += part
    return _newton_step(miss, push, columns, compliance)


def _newton_step(
    miss: Float[np.ndarray, " d"], push: "_Push", columns: Slices, compliance: SkinCompliance
) -> Float[np.ndarray, " d"]:
    """y with (1 + B C) y = miss; B is minus the derivative of the gels' forces (not symmetric if skin slips).

    GMRES solves it (Saad and Schultz, SIAM J. Sci. Stat. Comput. 7, 1986), or elimination if GMRES fails.
    """
    count = sum(c.stop - c.start for c in columns)
    short = _picked(miss, columns)

    def missed(y: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        return np.asarray(y + push.held_by(compliance.times(y, columns, columns)[:, None], columns)[:, 0])

    whole = LinearOperator((count, count), matvec=missed, dtype=float)
    step_N, left = gmres(whole, short, rtol=LEFT_SHARE, restart=GMRES_ROUNDS, maxiter=1)
    if left:
        moved = compliance.times(np.eye(count), columns, columns)
        step_N = np.linalg.solve(np.eye(count) + push.held_by(moved, columns), short)
    move = miss.copy()
    for c, part in parts_of(step_N, columns):
        move[c] = part
    return move


def _reach(grip: Grip, force: Float[np.ndarray, " d"]) -> Slices:
    """Unknowns with forces: each patch's nodes up to the last that bears one, and all inner points."""
    slices = []
    for side in (0, 1):
        part = grip.part(side)
        bearing = np.flatnonzero(force[part])
        if len(bearing):
            slices.append(slice(part.start, part.start + 3 * (int(bearing[-1]) // 3 + 1)))
    if grip.part(1).stop < len(force):
        slices.append(slice(grip.part(1).stop, len(force)))
    return tuple(slices)


def _picked(values: Float[np.ndarray, " d"], columns: Slices) -> Float[np.ndarray, " a"]:
    return np.concatenate([values[c] for c in columns]) if columns else values[:0]


class _Push:
    """Nodal forces of both gels and the inner contact at displacements u, and minus their derivative B."""

    def __init__(
        self, grip: Grip, links: list[Link], origins: Float[np.ndarray, "2 3"], u: Float[np.ndarray, " d"]
    ) -> None:
        self._grip, self._links = grip, links
        self._kept: dict[int, tuple[csr_array, np.ndarray]] = {}
        self._blocks, forces = [], []
        for side, link in enumerate(links):
            turn = grip.patches[side].turn
            position = np.asarray(link.shares @ grip.local(side, u, origins))
            load, change = traction(grip.gels[side], position, link.anchors_mm, link.stuck)
            forces.append(((link.shares.T @ (load * link.areas_mm2[:, None])) @ turn.T).ravel())
            self._blocks.append(turn @ (-change * link.areas_mm2[:, None, None]) @ turn.T)
        self._opening = u[grip.part(1).stop :]
        if grip.inner is not None:
            forces.append(grip.inner.push(self._opening))
        self.force_N = np.concatenate(forces)

    def held_by(self, x: Float[np.ndarray, "a k"], columns: Slices) -> Float[np.ndarray, "a k"]:
        """B x on the columns, for displacements x there."""
        pushes = []
        rest = x
        for c in columns:
            here, rest = rest[: c.stop - c.start], rest[c.stop - c.start :]
            sides = [s for s in (0, 1) if self._grip.part(s).start <= c.start < self._grip.part(s).stop]
            if not sides:
                pushes.append(self._inner_slope()[:, None] * here)
                continue
            shares, block = self._touching(sides[0], (c.stop - c.start) // 3)
            count = x.shape[1]
            at = np.asarray(shares @ here.reshape(-1, 3 * count)).reshape(-1, 3, count)
            pushes.append(np.asarray(shares.T @ (block @ at).reshape(-1, 3 * count)).reshape(-1, count))
        return np.concatenate(pushes)

    def _inner_slope(self) -> Float[np.ndarray, " p"]:
        if self._grip.inner is None:
            return np.zeros(len(self._opening))
        return self._grip.inner.slope(self._opening)

    def _touching(self, side: int, nodes: int) -> tuple[csr_array, Float[np.ndarray, "s 3 3"]]:
        """Gel points with stiffness: their interpolation from the first nodes, and their stiffness."""
        if side not in self._kept:
            block = self._blocks[side]
            touched = np.flatnonzero(np.abs(block).max(axis=(1, 2)) > 0)
            self._kept[side] = (csr_array(self._links[side].shares[touched][:, :nodes]), block[touched])
        return self._kept[side]
