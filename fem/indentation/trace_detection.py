"""Is there anything beyond noise that linear elasticity and its nuisances do not explain?"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from fem.indentation.fit import TraceFit
from fem.indentation.rig_error import rig_error
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import NoContactNoise, joint_clock

#: share of the force by which the tool itself errs: springs and tables against the exact integrals
TOOL = 2e-3
#: stretches of a phase that are looked at by themselves
STRETCHES = 6
#: noise-only traces that p-values are counted on
BANK = 999


@dataclass(frozen=True, kw_only=True)
class Detection:
    """p-value of the whole and of each statistic; `whitened`: the residual in standard deviations."""

    p_value: float
    statistics: dict[str, float]
    whitened: Float[np.ndarray, " t"]


def detect(
    fit: TraceFit,
    trace: IndenterTrace,
    no_contact: NoContactNoise,
    *,
    log_odds: float,
    rng: np.random.Generator,
) -> Detection:
    """Whiten, project out the nuisances, and count how many noise-only traces look as bad.

    Statistics: chi-square of all frames, the largest over stretches of load, hold and unload, and the lag-1
    product. The bank is white noise, scaled for how well the noise itself is known, projected alike. p is
    (1 + number as large)/(n + 1), of the smallest of the three (conformal); beyond the bank's reach the
    chi-square law takes over, times three. A fourth knows the effects: `log_odds` is the evidence for any of
    them over none, and under none odds beyond k have a probability of 1/k at most (Markov's inequality).
    The smaller of the two p-values counts, doubled for having chosen.
    """
    from scipy.stats import chi2  # slow to import, and bare traces alone need it

    size = np.maximum(np.abs(trace.force_N), 0.05 * np.abs(trace.force_N).max())
    clock = joint_clock(trace, white_N=no_contact.white_N)
    tool = (
        max(TOOL, rig_error(trace)) ** 2
        * np.outer(size, size)
        * np.exp(-np.abs(np.subtract.outer(clock, clock)))
    )
    root = np.linalg.cholesky(no_contact.covariance(len(clock)) + tool)
    gap = solve_triangular(root, trace.force_N - fit.force_N, lower=True)
    slope = solve_triangular(root, fit.jacobian, lower=True)
    basis = np.linalg.qr(slope)[0]
    gap = gap - basis @ (basis.T @ gap)
    groups = _stretches(trace)

    def statistics(z: Float[np.ndarray, "t b"]) -> Float[np.ndarray, "3 b"]:
        each = [chi2.logsf((z[k] ** 2).sum(axis=0), len(k)) for k in groups]
        whole = (z**2).sum(axis=0)
        return np.stack([whole, -np.min(each, axis=0), (z[1:] * z[:-1]).sum(axis=0)])

    draws = rng.standard_normal((len(gap), BANK))
    draws -= basis @ (basis.T @ draws)
    draws *= np.sqrt(no_contact.frames / rng.chisquare(no_contact.frames, BANK))
    nulls, found = statistics(draws), statistics(gap[:, None])[:, 0]
    each = (1 + (nulls >= found[:, None]).sum(axis=1)) / (BANK + 1)
    rank = (BANK - np.argsort(np.argsort(nulls, axis=1), axis=1)) / (BANK + 1)
    whole = float(1 + (rank.min(axis=0) <= each.min()).sum()) / (BANK + 1)
    if each.min() <= 1 / BANK:
        freedom = len(gap) - fit.jacobian.shape[1]
        far = 3 * float(chi2.sf(found[0] / (1 + 3 * np.sqrt(2 / no_contact.frames)), freedom))
        whole = min(whole, max(far, 1e-300))
    inverse_odds = float(np.exp(-max(log_odds, 0.0)))
    names = ("chi-square", "stretch", "lag-1", "evidence")
    return Detection(
        p_value=min(1.0, 2 * min(whole, max(inverse_odds, 1e-300))),
        statistics=dict(zip(names, [*each.tolist(), inverse_odds], strict=True)),
        whitened=gap,
    )


def _stretches(trace: IndenterTrace) -> list[np.ndarray]:
    """Frames of each recording's phases, cut into stretches of ten frames at least."""
    groups = []
    for start, part in zip(trace.starts, trace.parts, strict=True):
        phases = np.array(part.phases)
        for phase in ("load", "hold", "unload"):
            frames = start + np.flatnonzero(phases == phase)
            if len(frames):
                groups += np.array_split(frames, max(1, min(STRETCHES, len(frames) // 10)))
    return groups
