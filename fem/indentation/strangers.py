"""Comparison of recordings of one specimen: scatter of their moduli, and recordings that do not belong.

A law is fitted with a modulus for each recording. Each recording is compared with the others: ln E by
Student's t for one more draw from theirs, the curve's shape by its residual chi-square at the unexplained
share of force of the others. Source: Gelman et al., "Bayesian Data Analysis", 2013, ch. 6 (predictive
checks).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc, stdtr, stdtrit

from fem.indentation.contact_law import suffix_of
from fem.indentation.fit import SHARES, TraceFit, fit
from fem.indentation.no_contact import NoContactNoise
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import NINETY
from fem.mismatch.selection.decision import Detection

OTHER_SHAPE = "its curve has another shape"
#: least number of recordings for which one that does not belong can be identified
FEWEST_PARTS = 3


@dataclass(frozen=True)
class OwnModuli:
    """A law's fit to `trace` with a modulus for each recording: `ln_E` with `covariance`."""

    trace: IndenterTrace
    law_fit: TraceFit
    ln_E: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"]


def own_moduli(trace: IndenterTrace, known: TraceFit, no_contact: NoContactNoise) -> OwnModuli:
    """The law refitted with a modulus for each recording; a single recording's fit is `known`."""
    if len(trace.parts) == 1:
        return OwnModuli(trace, known, known.scaled[:1], known.covariance[:1, :1])
    law, at = known.law, len(known.law.baseline)
    extra = [replace(law.unknowns[0], name=f"E_MPa{suffix_of(k)}") for k in trace.numbers[1:]]
    start = np.insert(known.scaled, at, np.full(len(extra), known.scaled[0]))
    law_fit = fit(replace(law, baseline=(*law.baseline, *extra)), trace, no_contact, start[None])
    at_E = [0, *range(at, at + len(extra))]
    return OwnModuli(trace, law_fit, law_fit.scaled[at_E], law_fit.covariance[np.ix_(at_E, at_E)])


def scatter(moduli: OwnModuli, ln_E: float) -> tuple[float, float]:
    """Standard deviation of ln E between recordings in excess of the fit's error, and the term to add in
    quadrature to the error of `ln_E`, the law's common one; both are zero for a single recording.

    The term: the standard error of their mean, times Student's 95 % quantile over the normal's, and the
    distance of the mean from `ln_E`.
    """
    count = len(moduli.ln_E)
    if count == 1:
        return 0.0, 0.0
    of_fit = float(np.trace(moduli.covariance) - moduli.covariance.sum() / count) / (count - 1)
    sd = max(float(moduli.ln_E.var(ddof=1)) - of_fit, 0.0) ** 0.5
    of_mean = sd / count**0.5 * float(stdtrit(count - 1, 0.95)) / NINETY
    return sd, float(np.hypot(of_mean, moduli.ln_E.mean() - ln_E))


def strangers(moduli: OwnModuli) -> dict[int, str]:
    """Recordings that do not belong, by their index, each with a sentence. The least likely is removed first,
    then the next given the rest, while the smallest p-value, corrected for their number, is below
    DETECTION_P.
    """
    said: dict[int, str] = {}
    members = list(range(len(moduli.ln_E)))
    while len(members) >= FEWEST_PARTS:
        each = {
            f"{kind} {k}": p_value(moduli, k, [j for j in members if j != k])
            for k in members
            for kind, p_value in (("modulus", _modulus_p), ("shape", _shape_p))
        }
        test = Detection(p_values=each)
        if not test.mismatch:
            break
        kind, place = min(each, key=lambda name: each[name]).split()
        k = int(place)
        members.remove(k)
        ratio = float(np.exp(moduli.ln_E[k] - moduli.ln_E[members].mean()))
        how = f"its modulus is {ratio:.2f} times theirs" if kind == "modulus" else OTHER_SHAPE
        said[k] = (
            f"Recording {k + 1} does not belong to the others, and drupe leaves it out: {how} "
            f"(p {test.p_value:.2g}). Check that it is the same specimen."
        )
    return said


def _modulus_p(moduli: OwnModuli, k: int, others: Sequence[int]) -> float:
    """p-value of ln E of recording k given the others'. The variance is at least the fit's error variance."""
    theirs = moduli.ln_E[others]
    less = np.zeros(len(moduli.ln_E))
    less[k], less[others] = 1.0, -1 / len(others)
    of_fit = float(less @ moduli.covariance @ less)
    variance = max(float(theirs.var(ddof=1)) * (1 + 1 / len(others)), of_fit)
    t = abs(float(less @ moduli.ln_E)) / variance**0.5
    return float(2 * stdtr(len(others) - 1, -t))


def _shape_p(moduli: OwnModuli, k: int, others: Sequence[int]) -> float:
    """p-value of recording k's residual chi-square, at the others' unexplained share of the force."""
    trace, law_fit = moduli.trace, moduli.law_fit
    shares = SHARES[law_fit.usual_share * (1 - 1e-9) <= SHARES]
    gaps = trace.force_N - law_fit.force_N
    noise = [law_fit.noise.part(frames, 1 / law_fit.share) for frames in trace.slices]
    logs = [noise[j].log_likelihoods(gaps[trace.slices[j]], shares) for j in others]
    share = float(shares[int(np.argmax(np.sum(logs, axis=0)))])
    gap = gaps[trace.slices[k]]
    chi_square = float(gap @ law_fit.noise.part(trace.slices[k], share / law_fit.share).solve(gap))
    return float(gammaincc(len(gap) / 2, chi_square / 2))
