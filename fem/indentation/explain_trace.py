"""What a bare indenter's trace says of the flesh beyond linear elasticity: the public entry."""

import numpy as np

from fem.indentation.account import account_for
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import Explanation


def explain_trace(
    trace: IndenterTrace,
    *,
    thickness_mm: float | None,
    poisson_ratio: float,
    rng: np.random.Generator,
    rig_N_per_mm: float | None = None,
) -> Explanation:
    """Which missing physics explains the trace, its parameters, probability, and held-out frames.

    `thickness_mm` of the slab under a ball or punch, bonded to a rigid base; None: a half-space. The
    baseline is linear elasticity with contact that may start late (or before the recording), the load
    cell's zero, and a bend that stands for the theory's own error. Maps and traces stay empty: there are no
    markers.
    `rig_N_per_mm`: a stated stiffness of the rig, which no travel was corrected for; where the rig gives too
    much of the travel, E is withheld and said to be a lower bound (fem.indentation.rig_share).
    Raises FemFailure: bad-poisson-ratio, bad-load (thickness), no-load (force lost in noise).
    """
    return account_for(
        trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio, rng=rng, rig_N_per_mm=rig_N_per_mm
    ).explanation
