"""Which laws are tried: the linear one, every effect alone, and the pairs worth the time."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from fem.indentation.contact_law import Law
from fem.indentation.fit import TraceFit, fit
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_catalogue import TRACE_EFFECTS
from fem.indentation.trace_effect import TraceEffectSpec
from fem.indentation.trace_noise import NoContactNoise

#: starts drawn from the prior beside those that simpler laws suggest
DRAWS = 16
#: a single effect this far (natural logarithm) behind the best is tried in pairs with the best alone
BEHIND = 30.0


def candidate_fits(
    linear: Law,
    trace: IndenterTrace,
    no_contact: NoContactNoise,
    *,
    rng: np.random.Generator,
    effects: Sequence[TraceEffectSpec] = TRACE_EFFECTS,
) -> list[TraceFit]:
    """The linear fit first, then every effect in every form, then pairs; each starts from simpler ones.

    Pairs: the best single effect with every other, and those among the effects close behind it. Of an effect
    with several forms a pair takes the best and, where that has one arm, two arms as well: what a second
    effect leaves over may need them.
    """
    fits = [fit(linear, trace, no_contact, _starts(linear, [], rng))]
    singles: dict[str, list[TraceFit]] = {}
    for sought in effects:
        if sought.spec.name in linear.curve.without:
            continue
        for effect in sought.forms(trace):
            law = Law(curve=linear.curve, baseline=linear.baseline, effects=(effect,))
            known = [fits[0], *singles.get(effect.name, [])[-1:]]
            singles.setdefault(effect.name, []).append(fit(law, trace, no_contact, _starts(law, known, rng)))
    fits += [one for group in singles.values() for one in group]
    best = {name: max(group, key=lambda f: f.log_score) for name, group in singles.items()}
    top = max(best, key=lambda name: best[name].log_evidence)
    reach = best[top].log_evidence - BEHIND
    for pair in combinations(best, 2):
        if top not in pair and min(best[name].log_evidence for name in pair) < reach:
            continue
        chosen = [[best[name]] for name in pair]
        for k, name in enumerate(pair):
            if best[name].law.effects[0].arms == 1:
                chosen[k].append(singles[name][1])
        for one in chosen[0]:
            for other in chosen[1]:
                law = Law(
                    curve=linear.curve, baseline=linear.baseline, effects=one.law.effects + other.law.effects
                )
                fits.append(fit(law, trace, no_contact, _starts(law, [one, other], rng), follow=1))
    return fits


def _starts(law: Law, known: list[TraceFit], rng: np.random.Generator) -> Float[np.ndarray, "s k"]:
    """The prior's mean, draws from it, and draws in which what simpler fits found is kept."""
    names = [u.name for u in law.unknowns]
    mean = np.array([u.mean for u in law.unknowns])
    sd = np.array([u.sd for u in law.unknowns])
    rows = [mean, *(mean + 0.7 * sd * rng.standard_normal((DRAWS, len(mean))))]
    for one in known:
        kept = mean + 0.7 * sd * np.vstack([np.zeros(len(mean)), rng.standard_normal((DRAWS, len(mean)))])
        for u, value in zip(one.law.unknowns, one.scaled, strict=True):
            if u.name in names:
                kept[:, names.index(u.name)] = value
        rows += list(kept)
    return np.array(rows)
