"""Two pads on a fruit, one instant after the other, each in equilibrium.

The fruit answers through a dense stiffness S on the skin nodes that pads can reach: S (u - freely) = f(u),
where f is what the gel's springs put on the nodes and `freely` is where unloaded flesh would stand (not zero
once it has crept or yielded). Solved by Newton's method with a tangent that is kept while it serves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

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
from samples.mismatch.skin_patch import SkinPatch
from samples.sample_failure import NotInEquilibrium

TOLERANCE_N = 2e-7
"""N, norm over all nodes: seven orders below the pads' force of some newtons."""
LOOKS = 4
"""How often at most it is looked up anew which skin point a gel point meets (set by hand)."""
CONVERGED_MM = 2e-4
"""mm: a change of places below it ends that; a twentieth of a frame's noise of 4 um
(samples.sensor_noise)."""
SERVES = 0.4
"""A kept tangent serves while a round leaves less than this share of the miss."""


@dataclass(frozen=True, kw_only=True)
class InnerContact:
    """Points inside the fruit that push back, without friction, once they have closed by more than a gap."""

    gap_mm: float
    N_per_mm: Float[np.ndarray, " p"]

    def push(self, opening_mm: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Force that opens each point."""
        return np.asarray(self.N_per_mm * np.maximum(0.0, -(self.gap_mm + opening_mm)))

    def slope(self, opening_mm: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Minus the derivative of the push."""
        return np.where(opening_mm < -self.gap_mm, self.N_per_mm, 0.0)


@dataclass(frozen=True, kw_only=True)
class Grip:
    """What stays the same over a recording: patches, their nodes at rest (fruit frame), beds, the gel.

    With an `inner` contact the vector of unknowns goes on, after the skin's, with how far each of its points
    opens.
    """

    patches: tuple[SkinPatch, ...]
    rest_mm: tuple[Float[np.ndarray, "_n 3"], ...]
    bed: Bed
    gel: Gel
    inner: InnerContact | None = None

    def local(
        self, side: int, u: Float[np.ndarray, " d"], origins: Float[np.ndarray, "2 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Nodes of one patch in its pad's frame."""
        part = self.part(side)
        here = self.rest_mm[side] + u[part].reshape(-1, 3)
        return np.asarray((here - origins[side]) @ self.patches[side].turn)

    def part(self, side: int) -> slice:
        """Where the unknowns of one side are."""
        first = 0 if side == 0 else 3 * len(self.patches[0].nodes)
        return slice(first, first + 3 * len(self.patches[side].nodes))


@dataclass(frozen=True, kw_only=True)
class Instant:
    """One instant: skin displacement, nodal forces (fruit frame, N), pads' origins, what the gels hold."""

    u: Float[np.ndarray, " d"]
    force_N: Float[np.ndarray, " d"]
    origins: Float[np.ndarray, "2 3"]
    held: tuple[Held, ...]
    marker_shift_mm: tuple[Float[np.ndarray, "m 3"], ...]
    marker_force_N: tuple[Float[np.ndarray, "m 3"], ...]


class KeptTangent:
    """A factorised tangent that outlives its step: used again for as long as it serves."""

    solve: Callable[[Float[np.ndarray, " d"]], Float[np.ndarray, " d"]] | None = None


def before_touch(grip: Grip, origins: Float[np.ndarray, "2 3"], u: Float[np.ndarray, " d"]) -> Instant:
    """The first instant, in the air; the skin stands off its rest by u."""
    zero = np.zeros(len(u))
    still = np.zeros((grip.bed.markers, 3))
    return Instant(
        u=u, force_N=zero, origins=origins,
        held=(nothing_held(grip.bed), nothing_held(grip.bed)),
        marker_shift_mm=(still, still), marker_force_N=(still, still),
    )  # fmt: skip


def next_instant(
    grip: Grip,
    before: Instant,
    origins: Float[np.ndarray, "2 3"],
    stiffness: Float[np.ndarray, "d d"],
    freely: Float[np.ndarray, " d"],
    *,
    start: Float[np.ndarray, " d"] | None = None,
    kept: KeptTangent | None = None,
) -> Instant:
    """The instant with the pads' faces at `origins`. Raises NotInEquilibrium where Newton's method stalls."""
    u = before.u if start is None else start
    kept = kept or KeptTangent()
    was = [grip.local(s, before.u, before.origins) for s in (0, 1)]
    kept_on, look = list(before.held), 0
    while look < LOOKS:
        held = [
            looked_up(grip.bed, kept_on[s], grip.patches[s].cells, was[s], grip.local(s, u, origins))
            for s in (0, 1)
        ]
        links = [
            link_of(grip.gel, grip.bed, held[s], grip.patches[s].cells, len(grip.rest_mm[s])) for s in (0, 1)
        ]
        moved = _balanced(grip, links, origins, stiffness, freely, u, kept)
        change = np.abs(moved - u).max()
        u = moved
        lost = [let_go(grip.gel, kept_on[s], links[s], grip.local(s, u, origins)) for s in (0, 1)]
        if any(new is not None for new in lost):  # fewer hold each time: this ends
            kept_on = [old if new is None else new for old, new in zip(kept_on, lost, strict=True)]
            look = max(look, 1)
            continue
        look += 1
        if (look > 1 or start is not None) and change < CONVERGED_MM:
            break
    now = [grip.local(s, u, origins) for s in (0, 1)]
    if any(np.any(x[p.rim, 2] < 0) for x, p in zip(now, grip.patches, strict=True)):
        raise NotInEquilibrium("the contact patch outgrew the skin that was meshed for it: press less")
    force, _ = _pushed(grip, links, origins, u)
    seen = [marker_values(grip.gel, grip.bed, links[s], now[s]) for s in (0, 1)]
    memory = [
        after_step(grip.gel, grip.bed, held[s], grip.patches[s].cells, now[s], links[s]) for s in (0, 1)
    ]
    return Instant(
        u=u, force_N=force, origins=origins, held=(memory[0], memory[1]),
        marker_shift_mm=(seen[0][0], seen[1][0]), marker_force_N=(seen[0][1], seen[1][1]),
    )  # fmt: skip


def _balanced(
    grip: Grip, links: list[Link], origins: np.ndarray, stiffness: np.ndarray, freely: np.ndarray,
    start: np.ndarray, kept: KeptTangent,
) -> Float[np.ndarray, " d"]:  # fmt: skip
    """Newton's method with a factorised tangent that is kept for as long as it serves."""
    u = start
    force, tangent = _pushed(grip, links, origins, u)
    miss = stiffness @ (u - freely) - force
    size = float(np.linalg.norm(miss))
    for _ in range(200):
        if size < TOLERANCE_N:
            return u
        fresh = kept.solve is None
        solve = kept.solve or _factorised(stiffness, tangent())
        move = -solve(miss)
        for share in (1.0, 0.5, 0.25, 0.125, 0.06) if fresh else (1.0,):
            trial = u + share * move
            force, slope_there = _pushed(grip, links, origins, trial)
            left = stiffness @ (trial - freely) - force
            found = float(np.linalg.norm(left))
            if found < size:
                break
        kept.solve = solve if found < SERVES * size else None
        if fresh or found < size:
            u, miss, size, tangent = trial, left, found, slope_there
    raise NotInEquilibrium(f"a step of the grip stopped {size:.1e} N out of balance")


def _factorised(
    stiffness: np.ndarray, tangent: list[np.ndarray]
) -> Callable[[Float[np.ndarray, " d"]], Float[np.ndarray, " d"]]:
    matrix = stiffness.copy()
    first = 0
    for block in tangent:
        part = slice(first, first + len(block))
        matrix[part, part] += block
        first += len(block)
    factor = cho_factor(matrix, overwrite_a=True, check_finite=False)
    return lambda b: np.asarray(cho_solve(factor, b, check_finite=False))


def _pushed(
    grip: Grip, links: list[Link], origins: np.ndarray, u: np.ndarray
) -> tuple[Float[np.ndarray, " d"], Callable[[], list[np.ndarray]]]:
    """Nodal forces of both gels and the inner contact; on demand, block by block, minus their derivative."""
    forces, states = [], []
    for side, link in enumerate(links):
        turn = grip.patches[side].turn
        position = np.asarray(link.shares @ grip.local(side, u, origins))
        load, change = traction(grip.gel, position, link.anchors_mm, link.stuck)
        forces.append((link.shares.T @ (load * link.areas_mm2[:, None])) @ turn.T)
        states.append((link, position, change, turn))
    opening = u[grip.part(1).stop :]
    if grip.inner is not None:
        forces.append(grip.inner.push(opening))

    def tangents() -> list[np.ndarray]:
        found = [_tangent(grip.gel, *s) for s in states]
        return found if grip.inner is None else [*found, np.diag(grip.inner.slope(opening))]

    return np.concatenate([f.ravel() for f in forces]), tangents


def _tangent(
    gel: Gel, link: Link, position: np.ndarray, change: np.ndarray, turn: np.ndarray
) -> Float[np.ndarray, "n n"]:
    """Stick: one Gram matrix of the interpolation times the springs; slipping points take some of it away.

    How the shear of a slipping point follows its pressure is left out: the matrix stays symmetric.
    """
    holds = position[:, 2] < 0 if link.stuck is None else (position[:, 2] < 0) | link.stuck
    inside = holds & (link.areas_mm2 > 0)
    block = np.diag([gel.kt_MPa_per_mm, gel.kt_MPa_per_mm, gel.kn_MPa_per_mm])
    slips = inside & (np.abs(change + block).max(axis=(1, 2)) > 1e-12)
    shares = link.shares[inside]
    gram = (shares.T @ (shares * link.areas_mm2[inside][:, None])).toarray()
    gram = (gram + gram.T) / 2
    n = len(gram)
    whole = np.einsum("ab,ij->aibj", gram, turn @ block @ turn.T)
    whole = whole.reshape(3 * n, 3 * n)
    if not np.any(slips):
        return np.asarray((whole + whole.T) / 2)
    shares = link.shares[slips]
    less = change[slips] + block
    less[:, :2, 2] = 0.0
    lacking = np.einsum("ij,njk,lk->nil", turn, less, turn) * link.areas_mm2[slips][:, None, None]
    extra = np.zeros((n, 3, n, 3))
    for i in range(3):
        for k in range(3):
            extra[:, i, :, k] = (shares.T @ (shares * lacking[:, i, k][:, None])).toarray()
    whole -= extra.reshape(3 * n, 3 * n)
    return np.asarray((whole + whole.T) / 2)
