"""From fits to a ranking with probabilities, and to a verdict."""

import numpy as np
from scipy.special import logsumexp

from fem.indentation.contact_law import OWN
from fem.indentation.fit import TraceFit
from fem.mismatch.result import NONE, UNKNOWN, Candidate, Modulus, Parameter

#: prior of nothing at all, of all single effects together, and of all pairs
PRIOR_NONE, PRIOR_SINGLE, PRIOR_PAIR = 0.4, 0.45, 0.15
#: effects whose evidence is within this factor (natural logarithm) of the best cannot be told apart from it
APART = 3.0
#: p-value below which a mismatch is there
ALARM = 0.05
#: share of the force that the best law may leave unexplained and still be the explanation (what Hertz's
#: theory, in small strains and under a true ball, is itself off by), and of what the linear law leaves
LEFT_OVER, LEFT_OF_LINEAR = 0.05, 0.5
#: share of the force that the linear law must leave before it is called unexplained without any explanation
NOTICED = 0.01


def ranking(fits: list[TraceFit]) -> tuple[tuple[Candidate, ...], dict[str, TraceFit]]:
    """One candidate per name, most probable first, and the best fit of each; `fits[0]` is the linear one.

    A name's evidence is the mean over its forms. Its modulus is the fit's E: instantaneous where the flesh
    relaxes, as the law has it.
    """
    groups: dict[str, list[TraceFit]] = {}
    for one in fits:
        groups.setdefault(one.law.name, []).append(one)
    singles = sum("+" not in name for name in groups) - 1
    pairs = len(groups) - singles - 1
    log_prior = {
        name: float(
            np.log(
                PRIOR_NONE if name == NONE else PRIOR_PAIR / pairs if "+" in name else PRIOR_SINGLE / singles
            )
        )
        for name in groups
    }
    evidence = {
        name: float(logsumexp([f.log_evidence for f in group]) - np.log(len(group)))
        for name, group in groups.items()
    }
    score = {name: evidence[name] + log_prior[name] for name in groups}
    total = float(logsumexp(list(score.values())))
    best = {name: max(group, key=lambda f: f.log_evidence) for name, group in groups.items()}
    linear = fits[0]
    ordered = sorted((name for name in groups if name != NONE), key=lambda name: -score[name])
    return (
        tuple(
            Candidate(
                effect=name,
                probability=float(np.exp(score[name] - total)),
                parameters=parameters_of(best[name]),
                log_evidence=evidence[name] - evidence[NONE],
                gain=linear.chi_square - best[name].chi_square,
                refitted=True,
                modulus=modulus_of(best[name]),
            )
            for name in ordered
        ),
        best,
    )


def log_odds_of_any(fits: list[TraceFit]) -> float:
    """Evidence for any effect (singles and pairs weighed as their priors are) over that of none."""
    candidates, _ = ranking(fits)
    some = candidates[0]
    log_share = np.log(sum(c.probability for c in candidates)) - np.log(some.probability)
    prior = PRIOR_PAIR / sum("+" in c.effect for c in candidates)
    if "+" not in some.effect:
        prior = PRIOR_SINGLE / sum("+" not in c.effect for c in candidates)
    return float(some.log_evidence + np.log(prior) + log_share - np.log(1 - PRIOR_NONE))


def verdict_of(
    candidates: tuple[Candidate, ...], best: dict[str, TraceFit], *, p_value: float, log_odds: float
) -> str | tuple[str, ...]:
    """One name, several that cannot be told apart, "none", or "unknown".

    None: nothing beyond noise was detected; or no effect's evidence is up to an alarm and the linear law
    leaves less of the force than the theory errs by (coloured noise that too few frames in the air showed).
    Unknown: more than that is left, and by the best law more than half of it. A pair is not named beside one
    of its own effects alone: that explains it already.
    """
    if p_value > ALARM:
        return NONE
    if log_odds < np.log(2 / ALARM):
        return UNKNOWN if best[NONE].share > NOTICED else NONE
    if not explains(best[candidates[0].effect], best[NONE]):
        return UNKNOWN
    named = close_to_best(candidates)
    return named[0] if len(named) == 1 else named


def explains(one: TraceFit, linear: TraceFit) -> bool:
    """Whether a law leaves little enough of the force to be the explanation."""
    return one.share <= max(LEFT_OVER, LEFT_OF_LINEAR * linear.share)


def close_to_best(candidates: tuple[Candidate, ...]) -> tuple[str, ...]:
    """Names that evidence cannot tell from the first; no pair beside one of its own effects."""
    limit = np.log(candidates[0].probability) - APART
    close = [c.effect for c in candidates if np.log(max(c.probability, 1e-300)) >= limit]
    return tuple(n for n in close if not any(o != n and o in n.split("+") for o in close))


def modulus_of(one: TraceFit) -> Modulus:
    """E with its standard deviation, to first order."""
    value = float(np.exp(one.scaled[0]))
    return Modulus(value=value, sd=value * float(one.sd[0]))


def parameters_of(one: TraceFit) -> dict[str, Parameter]:
    """The effects' parameters by the names that files use, with onset and zero that go with them."""
    found: dict[str, Parameter] = {}
    at = 0
    for u in one.law.baseline:
        if u.name.startswith(OWN):
            found[u.name] = u.parameter(float(one.scaled[at]), float(one.sd[at]))
        at += 1
    for effect in one.law.effects:
        part = slice(at, at + len(effect.unknowns))
        if effect.parameters is not None:
            found |= effect.parameters(one.scaled[part], one.covariance[part, part])
        else:
            for u, value, sd in zip(effect.unknowns, one.scaled[part], one.sd[part], strict=True):
                found[u.name] = u.parameter(float(value), float(sd))
        at += len(effect.unknowns)
    return found
