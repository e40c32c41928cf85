"""What a softer ball in the flesh makes of one recording: to first order, and in full."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from fem.mismatch.baseline import Baseline, Seen
from fem.mismatch.inclusion import Softened

LEAST_SHARE = 1e-5
"""A pattern of force that does less than this share of a recording's work in the ball is left as it is."""


def to_first_order(base: Baseline, seen: Seen, inside: csr_array) -> Float[np.ndarray, "f n 3"] | None:
    """K0^-1 K1 U at the markers, for E = 1 MPa; None where nothing bears on the ball."""
    chosen, pushed = _bearing(seen, inside)
    if not chosen.any():
        return None
    given = base.answer(seen, pushed)
    return np.asarray(np.tensordot(seen.shares[:, chosen], given, axes=(1, 0)))


def softened(
    base: Baseline, seen: Seen, inside: csr_array, ratios: Sequence[float]
) -> list[Float[np.ndarray, "f n 3"]]:
    """The markers' displacement for E = 1 MPa outside the ball and each of these ratios of it inside."""
    chosen, _ = _bearing(seen, inside)
    if not chosen.any():
        return [seen.tracks.unit_displacement] * len(ratios)
    solid = base.solid_of(seen)
    reduced = Softened.of(
        inside, solid.displacement, seen.moved[chosen], _work(base, seen)[np.ix_(chosen, chosen)]
    )
    skin = solid.contact_nodes
    fields = np.stack([seen.moved[chosen][:, skin], reduced.first[:, skin], reduced.second[:, skin]])
    at_markers = np.stack([seen.at_markers(field) for field in fields])
    found = []
    for ratio in ratios:
        amounts = reduced.amounts(ratio)
        amounts[0] -= np.eye(len(amounts[0]))
        more = np.einsum("fs,prs,prnx->fnx", seen.shares[:, chosen], amounts, at_markers, optimize=True)
        found.append(np.asarray(seen.tracks.unit_displacement + more))
    return found


def _bearing(seen: Seen, inside: csr_array) -> tuple[Bool[np.ndarray, " r"], Float[np.ndarray, "c n 3"]]:
    """Which patterns do work inside the ball that counts, and K1 U_r of these."""
    flat = seen.moved.reshape(len(seen.moved), -1)
    pushed = np.asarray((inside @ flat.T).T)
    size = (seen.shares**2).sum(axis=0)
    own = np.einsum("rd,rd->r", flat, pushed) * size
    whole = float((seen.tracks.unit_displacement * seen.force_N).sum())
    chosen = own > LEAST_SHARE * whole
    return chosen, pushed[chosen].reshape(int(chosen.sum()), *seen.moved.shape[1:])


def _work(base: Baseline, seen: Seen) -> Float[np.ndarray, "r r"]:
    """U_r' f_s."""
    skin = base.solid_of(seen).contact_nodes
    work = np.tensordot(seen.moved[:, skin], seen.nodal_of(seen.patterns), axes=([1, 2], [1, 2]))
    return np.asarray((work + work.T) / 2)
