"""E of a bare indenter's trace by linear elasticity alone, without looking for anything beyond it."""

import numpy as np

from fem.indentation.fit import fit
from fem.indentation.no_contact import pooled_noise
from fem.indentation.posterior import modulus_of
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_baseline import linear_law
from fem.mismatch.result import Modulus


def linear_modulus(trace: IndenterTrace, *, thickness_mm: float | None, poisson_ratio: float) -> Modulus:
    """E and its standard deviation (MPa), with first touch, zero and the theory's own error taken out.

    The error bar allows for what the law leaves unexplained, not for the rig's spread. Raises FemFailure
    (bad-load) where the geometry has no law.
    """
    law = linear_law(trace, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    start = np.array([[u.mean for u in law.unknowns]])
    return modulus_of(fit(law, trace, pooled_noise(trace), start, follow=1))
