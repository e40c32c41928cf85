"""Values of an answer from fits: parameters with intervals, and moduli."""

import math

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect_spec import EffectParameter
from fem.mismatch.result import NINETY, Candidate, Modulus, Parameter, mixture
from fem.mismatch.selection.cross_validation import predictive, predictive_gain
from fem.mismatch.selection.grasp_explanations import Hypothesis
from fem.mismatch.selection.model_selection import ModelSelection
from fem.mismatch.selection.modulus_with import ModulusWith, modulus_with
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.screening import LinearRound
from fem.parallel_map import parallel_map


def candidates(selection: ModelSelection, linear: LinearRound, *, workers: int = 1) -> tuple[Candidate, ...]:
    """The ranking, with parameters of refitted effects; `workers`: threads."""
    base = predictive(linear.products, linear.nuisances)
    return tuple(
        parallel_map(
            lambda hypothesis: _candidate(hypothesis, linear, base), selection.ranking, workers=workers
        )
    )


def _candidate(
    hypothesis: Hypothesis, linear: LinearRound, base: Float[np.ndarray, " _g"] | None
) -> Candidate:
    """One hypothesis as a result; without parameters and modulus if it was not refitted."""
    if hypothesis.refit is None:
        drop = linear.null.chi2 - hypothesis.misfit * linear.numbers if hypothesis.linear_fits else 0.0
        return Candidate(
            effect=hypothesis.name,
            probability=hypothesis.probability,
            parameters={},
            log_evidence=hypothesis.gain,
            gain=drop,
        )
    again = hypothesis.refit
    after = predictive(again.products, (*again.nuisances, *again.slopes))
    modulus = modulus_with(again)
    return Candidate(
        effect=hypothesis.name,
        probability=hypothesis.probability,
        parameters=_parameters(again, modulus),
        log_evidence=hypothesis.gain,
        gain=again.signal,
        heldout=predictive_gain(base, after),
        refitted=True,
        modulus=_over_alternatives(modulus.known, hypothesis),
    )


def _over_alternatives(known: Modulus | None, hypothesis: Hypothesis) -> Modulus | None:
    """E as a mixture over pads that the recordings cannot separate, weighted by their probabilities."""
    others = [(share, modulus_with(again).known) for share, again in hypothesis.alternatives]
    there = [(share, modulus) for share, modulus in others if modulus is not None]
    if known is None or not there:
        return known
    share_of_best = 1 - sum(share for share, _ in hypothesis.alternatives)
    return mixture(
        [share_of_best, *(share for share, _ in there)], [known, *(modulus for _, modulus in there)]
    )


def _parameters(again: Refit, modulus: ModulusWith) -> dict[str, Parameter]:
    """A refit's parameters by name, with standard deviation and 90 % interval; components form vectors."""
    several = len(again.effects) > 1
    parameters: dict[str, Parameter] = {}
    first = 0
    for effect, variant, values in zip(again.effects, again.variants, again.parameters, strict=True):
        prefix = f"{effect.spec.name}." if several else ""
        for parameter in effect.spec.parameters:
            if parameter.kind == "pad":
                parameters[prefix + parameter.name] = Parameter(value=variant.pad, sd=None, unit="")
                continue
            said = [
                _said(parameter, spec, values[spec.name], first + k, modulus)
                for k, spec in enumerate(parameter.searched)
            ]
            first += len(said)
            if len(said) > 1:
                parameters[prefix + parameter.name] = Parameter(
                    value=tuple(v for v, _ in said), sd=tuple(s for _, s in said), unit=parameter.unit
                )
                continue
            ((value, spread),), (spec,) = said, parameter.searched
            ends = _ninety(value, spread, spec, scale=value / values[spec.name] if value else 1.0)
            parameters[prefix + parameter.name] = Parameter(
                value=value, sd=spread, unit=parameter.unit, interval=ends
            )
    return parameters


def _ninety(value: float, spread: float, spec: EffectParameter, *, scale: float = 1.0) -> tuple[float, float]:
    """The 90 % interval, of the value or its logarithm; `scale`: factor from the bounds' unit to its own."""
    if spec.log:
        return value * math.exp(-NINETY * spread / value), value * math.exp(NINETY * spread / value)
    low, high = value - NINETY * spread, value + NINETY * spread
    return max(low, scale * spec.low), min(high, scale * spec.high)


def _said(
    parameter: EffectParameter, spec: EffectParameter, value: float, number: int, modulus: ModulusWith
) -> tuple[float, float]:
    """Reported value v E^p of a searched number v, and its standard deviation, with E's dependence on v."""
    size = value if spec.log else 1.0
    spread = float(size * modulus.sd[number])
    power, E = parameter.modulus_power, modulus.at
    if not power:
        return value, spread
    scale = E.value**power
    parameter_sd = (scale + power * value * scale * modulus.change[number] / size) * spread
    return value * scale, float(np.hypot(parameter_sd, power * value * E.value ** (power - 1) * E.sd))
