"""One posterior over all laws of a trace: probabilities, the verdict, and E with its standard deviation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from fem.indentation.contact_law import OWN
from fem.indentation.fit import TraceFit
from fem.indentation.rig_share import widened
from fem.indentation.trace import IndenterTrace
from fem.mismatch.result import NONE, UNKNOWN, Candidate, Modulus, Parameter, mixture

PRESENT = 0.01
"""Prior probability of each effect, independent of the others."""
OTHER = 0.01
"""Prior probability of physics outside the catalogue, which leaves OTHER_RATIO (fem.indentation.fit) times as
much of the force unexplained."""
CONTAINED = 0.95
"""Probability that the verdict holds the truth."""
LEAST_WEIGHT = 1e-4
"""Probability of a law below which its force is left out of the mean."""
NUISANCES = (*OWN, "ends_held")
"""Unknowns of the plain law that are reported with every effect."""


@dataclass(frozen=True, kw_only=True)
class CurvePosterior:
    """`probability` by name (effects joined by "+", "none", "unknown"), the largest first; `best`: the
    likeliest fit of each name; `modulus`: E over all `fits` by their `weights`; `log_odds` of any effect or
    other physics over none, without their prior.
    """

    fits: tuple[TraceFit, ...]
    weights: Float[np.ndarray, " f"]
    probability: dict[str, float]
    log_evidence: dict[str, float]
    best: dict[str, TraceFit]
    modulus: Modulus
    log_odds: float

    @property
    def verdict(self) -> str | tuple[str, ...]:
        """The smallest set of names that holds CONTAINED."""
        reached = np.cumsum(list(self.probability.values()))
        count = int(np.searchsorted(reached, CONTAINED)) + 1
        names = tuple(self.probability)[:count]
        return names[0] if len(names) == 1 else names

    @property
    def likeliest(self) -> TraceFit:
        """The fit of the likeliest law; of other physics, the best of the catalogue."""
        return self.best[next(name for name in self.probability if name != UNKNOWN)]

    def force_N(self, trace: IndenterTrace) -> Float[np.ndarray, " t"]:
        """Mean over the laws, by their probabilities."""
        likely = np.flatnonzero(self.weights > LEAST_WEIGHT)
        forces = [self.fits[k].law.force_N(trace, self.fits[k].scaled[None])[0] for k in likely]
        return np.asarray(self.weights[likely] @ np.array(forces) / self.weights[likely].sum())

    @property
    def ranking(self) -> tuple[Candidate, ...]:
        """Every law with an effect, the likeliest first."""
        plain = self.best[NONE]
        return tuple(
            Candidate(
                effect=name,
                probability=probability,
                parameters=parameters_of(self.best[name]),
                log_evidence=self.log_evidence[name] - self.log_evidence[NONE],
                gain=plain.chi_square - self.best[name].chi_square,
                refitted=True,
                modulus=modulus_of(self.best[name]),
            )
            for name, probability in self.probability.items()
            if name not in (NONE, UNKNOWN)
        )


def posterior(fits: list[TraceFit]) -> CurvePosterior:
    """Of all fitted laws, with each effect by itself in all of its forms.

    p(H) = prior(H) evidence(H) / sum. An effect is there or not, independent of the others; its forms share
    its prior, half as much for each further unknown. Every law stands twice: with the share of the force that
    a law in the catalogue leaves, and, in "unknown", with the share that is left where physics outside the
    catalogue is at work. E is the mixture over all of it; with physics outside the catalogue the share of the
    force that is not explained is one of E as well.
    """
    forms: dict[str, float] = {}
    for effect in (one.law.effects[0] for one in fits if len(one.law.effects) == 1):
        forms[effect.name] = forms.get(effect.name, 0.0) + 0.5 ** len(effect.unknowns)
    count = len(forms)
    logs: dict[str, list[float]] = {}
    prior_of: dict[str, float] = {}
    best: dict[str, TraceFit] = {}
    others, weights, moduli = [], [], []
    for one in fits:
        effects = [effect.name for effect in one.law.effects]
        prior = len(effects) * np.log(PRESENT) + (count - len(effects)) * np.log1p(-PRESENT)
        prior_of[one.law.name] = float(prior)
        prior += sum(np.log(0.5 ** len(effect.unknowns) / forms[effect.name]) for effect in one.law.effects)
        known = prior + np.log1p(-OTHER) + one.log_evidence
        other = prior + np.log(OTHER) + one.log_evidence_of_other
        logs.setdefault(one.law.name, []).append(known)
        others.append(other)
        weights += [known, other]
        moduli += [modulus_of(one), widened(modulus_of(one), one.share)]
        if one.law.name not in best or one.log_score > best[one.law.name].log_score:
            best[one.law.name] = one
    score = {name: float(logsumexp(group)) for name, group in logs.items()} | {
        UNKNOWN: float(logsumexp(others))
    }
    total = float(logsumexp(list(score.values())))
    ordered = sorted(score, key=lambda name: -score[name])
    plain = float(logsumexp(logs[NONE]))
    prior_of_none = count * np.log1p(-PRESENT) + np.log1p(-OTHER)
    log_any = float(logsumexp([value for name, value in score.items() if name != NONE]))
    weight = np.exp(np.array(weights) - max(weights)).reshape(-1, 2)
    return CurvePosterior(
        fits=tuple(fits),
        weights=weight.sum(axis=1) / weight.sum(),
        probability={name: float(np.exp(score[name] - total)) for name in ordered},
        log_evidence={name: score[name] - prior for name, prior in prior_of.items()},
        best=best,
        modulus=mixture(weight.ravel().tolist(), moduli),
        log_odds=log_any - np.log(-np.expm1(prior_of_none)) - (plain - prior_of_none),
    )


def modulus_of(one: TraceFit) -> Modulus:
    """E with its standard deviation, to first order."""
    value = float(np.exp(one.scaled[0]))
    return Modulus(value=value, sd=value * float(one.sd[0]))


def parameters_of(one: TraceFit) -> dict[str, Parameter]:
    """The effects' parameters by the names that files use, with the nuisances that a reader must know."""
    known: dict[str, Parameter] = {}
    at = 0
    for u in one.law.baseline:
        if u.name.startswith(NUISANCES):
            known[u.name] = u.parameter(float(one.scaled[at]), float(one.sd[at]))
        at += 1
    for effect in one.law.effects:
        part = slice(at, at + len(effect.unknowns))
        if effect.parameters is not None:
            known |= effect.parameters(one.scaled[part], one.covariance[part, part])
        else:
            for u, value, sd in zip(effect.unknowns, one.scaled[part], one.sd[part], strict=True):
                known[u.name] = u.parameter(float(value), float(sd))
        at += len(effect.unknowns)
    return known
