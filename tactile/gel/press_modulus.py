"""The gel's modulus from a press onto a load cell.

Computed forces are proportional to the assumed modulus. The true modulus is therefore the assumed one times
the gain g = sum W F / sum F^2 over the frames of a press. W is the load cell's force along the pad's normal,
F the gel's. The gain's standard deviation follows from the scatter about one line. The whole contact must be
in view, and the press must be normal: the gain ignores friction.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactile.tactile_failure import TactileProblem

LEAST_SHARE = 0.2
"""Least share of the greatest force, of gel and cell each, in a frame that counts. Set by hand."""
FEWEST_FRAMES = 5
"""Fewest such frames: they determine a line and the scatter about it. Set by hand."""
NOT_ONE_LINE = 0.1
"""Most scatter about the line over the greatest force. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class GelGain:
    """Force of the load cell over the gel's: value, standard deviation, and scatter over the peak force."""

    value: float
    sd: float
    residual: float


def gel_gain(cell_N: Float[np.ndarray, " t"], gel_N: Float[np.ndarray, " t"], *, source: str) -> GelGain:
    """The factor from the gel's forces to the load cell's; signs do not matter.

    Only frames with a fifth of both peak forces count. Raises TactileFailure (unreadable-frames) for fewer
    than five of them. It also raises if they scatter about one line through zero by over a tenth of the peak.

    A gel that reads 8 N where the cell reads 10 N:

    >>> round(gel_gain(np.linspace(0, 10, 50), np.linspace(0, 8, 50), source="press.csv").value, 6)
    1.25
    """
    W, F = np.abs(cell_N), np.abs(gel_N)
    felt_by_cell, felt_by_gel = (f > LEAST_SHARE * f.max(initial=0.0) for f in (W, F))
    used = felt_by_cell & felt_by_gel
    if used.sum() < FEWEST_FRAMES:
        raise TactileProblem.UNREADABLE_FRAMES.failure(
            f"{source}: found {int(used.sum())} frames in which gel and load cell measure the press, "
            f"expected at least {FEWEST_FRAMES}; press harder, or more slowly.",
        )
    W, F = W[used], F[used]
    value = float((W @ F) / (F @ F))
    scatter = float(np.sqrt(((W - value * F) ** 2).sum() / (len(W) - 1)))
    if scatter > NOT_ONE_LINE * W.max():
        raise TactileProblem.UNREADABLE_FRAMES.failure(
            f"{source}: gel and load cell differ by {100 * scatter / W.max():.0f} % of the peak, "
            "expected one line through zero; check that the whole contact is in view and both clocks "
            "agree.",
        )
    return GelGain(value=value, sd=scatter / float(np.sqrt(F @ F)), residual=scatter / float(W.max()))
