"""Recordings of another specimen among those of one: their modulus is not the others'."""

import numpy as np

from fem.indentation.fit import TraceFit
from fem.indentation.trace import IndenterTrace

STRANGER_SD, STRANGE = 0.5, 100.0
"""Standard deviation of ln E of a recording of another specimen, and the odds from which it is named: a
recording in a hundred is one."""
#: recordings from which on it can be told which of them does not belong
FEWEST_PARTS = 3


def strangers(trace: IndenterTrace, known: TraceFit) -> tuple[str, ...]:
    """Recordings that do not have the modulus of the others: the likeliest first, then the next given this
    one, while the evidence for a modulus of its own outweighs STRANGE against.

    ln of the Bayes factor for another modulus against none, linear round `known`: prior over posterior
    density at nought (Savage and Dickey).
    """
    said: dict[int, str] = {}
    off = known.scaled - np.array([u.mean for u in known.law.unknowns])
    precision = np.array([u.sd**-2.0 for u in known.law.unknowns])
    slope = known.jacobian
    gap = trace.force_N - known.force_N
    while len(said) < len(trace.parts) - FEWEST_PARTS + 1:
        off, precision = np.append(off, 0.0), np.append(precision, STRANGER_SD**-2.0)
        tried = []
        for k in set(range(len(trace.parts))) - said.keys():
            own = np.zeros(len(gap))
            own[trace.slices[k]] = known.jacobian[trace.slices[k], 0]
            columns = np.column_stack([slope, own])
            weighted = known.noise.solve(np.column_stack([columns, gap]))
            covariance = np.linalg.inv(columns.T @ weighted[:, :-1] + np.diag(precision))
            ln_ratio = float((covariance @ (columns.T @ weighted[:, -1] - precision * off))[-1])
            variance = float(covariance[-1, -1])
            log_factor = 0.5 * (ln_ratio**2 / variance + np.log(variance / STRANGER_SD**2))
            tried.append((log_factor, k, ln_ratio, columns))
        log_factor, k, ln_ratio, slope = max(tried, key=lambda one: one[0])
        if log_factor < np.log(STRANGE):
            break
        said[k] = (
            f"Recording {k + 1} does not belong to the others: its modulus is {np.exp(ln_ratio):.2f} times "
            "theirs. Check that it is the same specimen."
        )
    return tuple(said.values())
