"""E that is reported: the mean over all explanations by their probabilities, and the 90 % interval of all.

An explanation that was refitted has an E of its own; one that was not has that of its linear signature;
"unknown" has the plain model's E, as uncertain as unknown physics has made it. Where no mismatch was detected
effects widen the error bar and do not move E.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from fem.mismatch.effect import Effect
from fem.mismatch.gel_fault import is_of_relation
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.result import NONE, UNKNOWN, Candidate, HeldOut, Modulus, mixture
from fem.mismatch.selection.linear_explanations import Hypothesis
from fem.mismatch.selection.refinement import Refit

LARGE_MISFIT = 2.0
"""Times the noise, root mean square in recordings left out. Set by hand."""
UNKNOWN_MODULUS_SD, LARGE_MISFIT_MODULUS_SD = 0.17, 0.3
"""Relative; of E where something unknown is missing, without and with a large misfit. So that nine of ten of
the plain model's errors on labelled cases with an effect lie within 1.645 of it, of 34 cases and of 28
(`benchmarks/results/mismatch.csv`)."""


def reported_modulus(
    verdict: str | tuple[str, ...],
    ranking: Sequence[Hypothesis],
    candidates: Sequence[Candidate],
    plain: Modulus,
    *,
    hidden: float = 0.0,
    heldout: HeldOut | None = None,
) -> Modulus:
    """E as the module's docstring says; the plain model's where no explanation has an E.

    `candidates`: the same ranking with the refits' E. `hidden`: relative spread by faults of the gel that are
    not in the ranking. `heldout`: how the plain model predicts recordings left out.
    """
    weights, moduli = [], []
    for hypothesis, candidate in zip(ranking, candidates, strict=True):
        modulus = _modulus_by(hypothesis, candidate, plain, heldout)
        if modulus is not None:
            weights.append(hypothesis.probability)
            moduli.append(modulus)
    if not sum(weights) > 0:
        return _widened(plain, hidden)
    about = plain.value if verdict == NONE else None
    return _widened(mixture(weights, moduli, about=about), hidden)


def _modulus_by(
    hypothesis: Hypothesis, candidate: Candidate, plain: Modulus, heldout: HeldOut | None
) -> Modulus | None:
    if hypothesis.name == NONE:
        return plain
    if hypothesis.name == UNKNOWN:
        return _widened(plain, unknown_spread(heldout))
    if hypothesis.refit is not None or hypothesis.modulus_change is None:
        return candidate.modulus
    ratio, added = hypothesis.modulus_change
    return _widened(Modulus(value=ratio * plain.value, sd=ratio * plain.sd), added)


def unknown_spread(heldout: HeldOut | None) -> float:
    """Relative spread of E by physics that is not known."""
    large = heldout is not None and heldout.rms_before > LARGE_MISFIT * heldout.noise_rms
    return LARGE_MISFIT_MODULUS_SD if large else UNKNOWN_MODULUS_SD


def _widened(modulus: Modulus, relative_sd: float) -> Modulus:
    return replace(modulus, sd=float(np.hypot(modulus.sd, relative_sd * modulus.value)))


@dataclass(frozen=True, kw_only=True)
class HiddenGelFault:
    """A fault of the gel that is not named and that force against displacement does not exclude: its
    parameters as measured, its probability, and the relative change of E by it.
    """

    name: str
    values: Mapping[str, float]
    probability: float
    modulus_change: float

    @property
    def spread(self) -> float:
        """Relative spread of E, which is without it: root mean square."""
        return float(np.sqrt(self.probability) * abs(self.modulus_change))


def hidden_gel_faults(
    model: CaseModel, effects: Sequence[Effect], named: Refit | None
) -> list[HiddenGelFault]:
    """Those of `effects` with which the flesh's equations fit better.

    At even odds beforehand one is there with probability 1 / (1 + exp(-ln evidence)). None beside a named one
    of the same relation: each shows in part as another.
    """
    if named is not None and any(map(is_of_relation, named.effects)):
        return []
    measured = [(fault, fault.measured(model)) for fault in effects if is_of_relation(fault)]
    return [
        HiddenGelFault(
            name=fault.spec.name,
            values=known.values,
            probability=float(expit(known.evidence)),
            modulus_change=fault.modulus_change(model),
        )
        for fault, known in measured
        if known is not None and fault.flesh_gain(model) > 0
    ]
