"""Recordings of one specimen beside each other: how far their moduli scatter, and which do not belong.

Recording k has the modulus E exp(s_k), s_k ~ N(0, tau^2), ln tau uniform over SCATTERS; all else of the law
is common. Each recording is compared with its predictive distribution given the others, by its s_k and by the
chi-square that its curve has with a modulus of its own. Linear round about a fit with a modulus for each.
Source: Gelman et al., "Bayesian Data Analysis", 2013, ch. 5 (exchangeable groups) and 6 (predictive checks).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc, ndtr, softmax

from fem.indentation.contact_law import suffix_of
from fem.indentation.fit import SHARES, TraceFit, fit
from fem.indentation.no_contact import NoContactNoise
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import TraceNoise
from fem.mismatch.selection.decision import DETECTION_P, smallest_p_value

STRANGER_SD = 0.5
"""Standard deviation of ln E of another specimen's recording. Set by hand; one specimen's scatter less."""
#: values of tau, equally likely beforehand: from next to none to that of strangers (set by hand)
SCATTERS = np.geomspace(1e-3, STRANGER_SD, 24)
OTHER_SHAPE = "its curve has another shape"
#: recordings from which on it can be told which of them does not belong
FEWEST_PARTS = 3


@dataclass(frozen=True, kw_only=True)
class OwnModuli:
    """`law_fit`: a law's fit to `trace` with a modulus for each recording, `ln_E`, which are these
    `columns`.
    """

    trace: IndenterTrace
    law_fit: TraceFit
    columns: list[int]
    ln_E: Float[np.ndarray, " n"]


def own_moduli(trace: IndenterTrace, known: TraceFit, no_contact: NoContactNoise) -> OwnModuli:
    """The law refitted, each recording with a modulus of its own."""
    law, at = known.law, len(known.law.baseline)
    extra = [replace(law.unknowns[0], name=f"E_MPa{suffix_of(k)}") for k in trace.numbers[1:]]
    start = np.insert(known.scaled, at, np.full(len(extra), known.scaled[0]))
    law_fit = fit(replace(law, baseline=(*law.baseline, *extra)), trace, no_contact, start[None], follow=1)
    columns = [0, *range(at, at + len(extra))]
    return OwnModuli(trace=trace, law_fit=law_fit, columns=columns, ln_E=law_fit.scaled[columns])


def likeliest_with_own_moduli(
    trace: IndenterTrace, best: Mapping[str, TraceFit], no_contact: NoContactNoise
) -> OwnModuli:
    """Of the plain law and the single effects, by evidence: a law that is common to all moduli bends to a
    recording of another specimen.
    """
    each = [own_moduli(trace, trace_fit, no_contact) for name, trace_fit in best.items() if "+" not in name]
    return max(each, key=lambda moduli: moduli.law_fit.log_score)


def scatter(trace: IndenterTrace, known: TraceFit, no_contact: NoContactNoise) -> tuple[float, float]:
    """Standard deviation of ln E from recording to recording (mean over tau), and what is to be added in
    squares to that of the law's ln E; none for a recording alone.
    """
    if len(trace.parts) == 1:
        return 0.0, 0.0
    moduli = own_moduli(trace, known, no_contact)
    gram = _grams(moduli, moduli.law_fit.share).sum(axis=0)
    solved = [_solved(gram, moduli, np.full(len(moduli.ln_E), tau)) for tau in SCATTERS]
    weights = softmax([log for _, _, log in solved])
    off = float(moduli.ln_E.mean() - known.scaled[0])
    square = weights @ [covariance[0, 0] + (off + change[0]) ** 2 for change, covariance, _ in solved]
    added = max(float(square - known.covariance[0, 0]), 0.0)
    return float(weights @ SCATTERS), added**0.5


def strangers(moduli: OwnModuli) -> dict[int, str]:
    """Recordings that do not belong, by their index, each with a sentence: the least likely first, then the
    next given the rest, while the smallest p-value of all, corrected for their number, is below DETECTION_P.
    """
    said: dict[int, str] = {}
    members = list(range(len(moduli.ln_E)))
    while len(members) >= FEWEST_PARTS:
        tried = {k: _p_values(moduli, k, [j for j in members if j != k]) for k in members}
        each = {(kind, k): p for k, (p_values, _) in tried.items() for kind, p in p_values.items()}
        p_value = smallest_p_value({f"{kind} {k}": p for (kind, k), p in each.items()})
        if p_value >= DETECTION_P:
            break
        kind, k = min(each, key=lambda name: each[name])
        how = f"its modulus is {tried[k][1]:.2f} times theirs" if kind == "modulus" else OTHER_SHAPE
        said[k] = (
            f"Recording {k + 1} does not belong to the others, and drupe leaves it out: {how} "
            f"(p {p_value:.2g}). Check that it is the same specimen."
        )
        members.remove(k)
    return said


def _p_values(moduli: OwnModuli, k: int, others: Sequence[int]) -> tuple[dict[str, float], float]:
    """Of recording k given others: "modulus" and "shape"; and its modulus over theirs."""
    trace, law_fit = moduli.trace, moduli.law_fit
    shares = SHARES[law_fit.usual_share * (1 - 1e-9) <= SHARES]
    gaps = trace.force_N - law_fit.force_N
    logs = [
        _noise(law_fit, trace.slices[j], 1.0).log_likelihoods(gaps[trace.slices[j]], shares) for j in others
    ]
    grams = _grams(moduli, float(shares[int(np.argmax(np.sum(logs, axis=0)))]))
    theirs, at = grams[list(others)].sum(axis=0), len(law_fit.scaled) - len(moduli.ln_E) + 1 + k

    alone = np.arange(len(moduli.ln_E)) == k
    solved = [_solved(theirs + grams[k], moduli, np.where(alone, STRANGER_SD, tau)) for tau in SCATTERS]
    weights = softmax([log for _, _, log in solved])
    variance = np.array([covariance[at, at] for _, covariance, _ in solved])
    mean = np.array([change[at] for change, _, _ in solved]) + moduli.ln_E[k] - moduli.ln_E.mean()
    # less the prior of s_k: what the recording itself says
    of_data = 1 / np.maximum(1 / variance - STRANGER_SD**-2, 1e-6)
    mean = mean * of_data / variance
    change, covariance, _ = _solved(theirs, moduli, np.where(alone, STRANGER_SD, weights @ SCATTERS))
    normal, right, square = grams[k][:-1, :-1], grams[k][:-1, -1], grams[k][-1, -1]
    left = right - normal @ change
    known = left @ np.linalg.inv(np.linalg.inv(covariance) + normal) @ left
    chi_square = square - (right + left) @ change - known
    frames = trace.slices[k].stop - trace.slices[k].start
    p_values = {
        "modulus": float(2 * weights @ ndtr(-np.abs(mean) / np.sqrt(of_data + SCATTERS**2))),
        "shape": float(gammaincc(frames / 2, max(float(chi_square), 0.0) / 2)),
    }
    return p_values, float(np.exp(weights @ mean))


def _noise(law_fit: TraceFit, frames: slice, share: float) -> TraceNoise:
    """Of one recording, with so large a share of the force unexplained."""
    wander_N = law_fit.noise.wander_N[frames] * (share / law_fit.share)
    return replace(law_fit.noise, wander_N=wander_N, clock=law_fit.noise.clock[frames])


def _grams(moduli: OwnModuli, share: float) -> Float[np.ndarray, "n q q"]:
    """Z' C^-1 Z of each recording: Z the slopes of ln E, of the law's other unknowns and of each s, and the
    force that is left.
    """
    grams, jacobian = [], moduli.law_fit.jacobian
    left = moduli.trace.force_N - moduli.law_fit.force_N
    for frames, column in zip(moduli.trace.slices, moduli.columns, strict=True):
        of_E, others = jacobian[frames, column], np.delete(jacobian[frames], moduli.columns, axis=1)
        columns = np.column_stack([of_E, others, jacobian[frames][:, moduli.columns], left[frames]])
        grams.append(columns.T @ _noise(moduli.law_fit, frames, share).solve(columns))
    return np.array(grams)


def _solved(
    gram: Float[np.ndarray, "q q"], moduli: OwnModuli, sd: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"], float]:
    """Changes of ln E, the law's other unknowns and s, whose prior has `sd`; covariance; ln evidence."""
    priors = np.array([(u.mean, u.sd) for u in moduli.law_fit.law.unknowns])
    priors = np.delete(priors, moduli.columns[1:], axis=0)
    scaled = np.delete(moduli.law_fit.scaled, moduli.columns[1:])
    scaled[0] = moduli.ln_E.mean()
    precision = np.r_[priors[:, 1], sd] ** -2.0
    off = np.r_[scaled - priors[:, 0], moduli.ln_E - moduli.ln_E.mean()]
    covariance = np.linalg.inv(gram[:-1, :-1] + np.diag(precision))
    pull = gram[:-1, -1] - precision * off
    log_det = np.linalg.slogdet(covariance)[1] + np.log(precision).sum()
    log = 0.5 * (pull @ covariance @ pull - precision @ off**2 + log_det)
    return covariance @ pull, covariance, float(log)
