"""The mismatch decision on a stored round with a model error, and its truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from apparent_shares import ModelError, fruit_of
from cramer_rao import NUISANCE, amplitude_bounds, amplitudes_of
from reduced_case import OF_MODEL_ERROR, ReducedCase
from sealed_scores import Scored, scored

from fem.mismatch.catalogue import SPECS
from fem.mismatch.procedure import detected
from fem.mismatch.result import NINETY, NONE, UNKNOWN, Modulus
from fem.mismatch.selection.decision import Detection, verdict_of
from fem.mismatch.selection.grasp_explanations import Hypothesis, all_explanations, ranked
from fem.mismatch.selection.reported_modulus import modulus_by, reported_modulus
from fem.mismatch.selection.screening import LinearRound, without_model_error
from samples.mismatch.bank import added_effects

PLAIN_E_SD = 0.02
"""Relative error of the plain model's E, added to each explanation's. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class ScoredRound:
    """A case and its answer. `stored` is as it was read, all else has the model error `error`."""

    scored: Scored
    fruit: str
    stored: ReducedCase
    error: ModelError
    linear: LinearRound
    explanations: tuple[Hypothesis, ...]
    detection: Detection

    @cached_property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Of each effect that has both: the least sd of its amplitude by noise alone, and with nuisances and
        model error as the decision sees them.
        """
        noise = self.stored.facts.get("bounds") or {}
        full = full_bounds(self.stored.with_model_error(self.error.shares)) if noise else {}
        return {effect: (noise[effect], full[effect]) for effect in noise if effect in full}

    def over_bound(self, which: int) -> float | None:
        """Amplitude of a single effect over its bound by noise (0) or in full (1)."""
        truth = self.scored.truth
        known = self.bounds.get(truth) if truth in self.scored.amplitudes else None
        return None if known is None else self.scored.amplitudes[truth] / known[which]


def full_bounds(case: ReducedCase) -> dict[str, float]:
    """Bounds of amplitudes by the products that decide, the model's own error among the nuisances."""
    return amplitude_bounds(
        case.information(),
        case,
        E_MPa=float(case.facts["E_MPa"]),
        nuisances=(NUISANCE, OF_MODEL_ERROR),
    )


def scored_round(name: str, case: ReducedCase, error: ModelError | None = None) -> ScoredRound:
    """The decision on a stored round, and its truth; `error`: the model's own (None: the shipped one)."""
    error = ModelError.shipped() if error is None else error
    linear = error.linear(case)
    explanations = all_explanations(linear)
    detection = detected(linear)
    answer = case.facts["answer"]
    effects = () if answer["effect"] in (NONE, UNKNOWN) else str(answer["effect"]).split("+")
    kind = {NONE: "sound", UNKNOWN: "outside"}.get(answer["effect"], "pair" if len(effects) > 1 else "single")
    as_stored = case.gram().fit(case.nuisances).amounts[0]
    plain_fit = linear.products.fit(without_model_error(linear.products, linear.nuisances))
    plain_E = float(case.facts["E_MPa"] * (1 + as_stored) / (1 + plain_fit.amounts[0]))
    plain = Modulus(value=plain_E, sd=PLAIN_E_SD * plain_E)
    ranking = posterior(explanations)
    verdict = verdict_of(dict(ranking), p_value=detection.p_value)
    weighed = [(each.probability, modulus_by(each, None, plain, None)) for each in ranked(explanations)]
    after = reported_modulus(NONE if verdict == (NONE,) else verdict, weighed, plain)
    row = {
        "case": name,
        "attempt": 0,
        "catalogue": SPECS,
        "detected": detection.mismatch,
        "verdict": verdict,
        "ranking": [
            {"effect": effect, "probability": p, "refitted": False, "parameters": {}} for effect, p in ranking
        ],
        "p": detection.p_value,
        "E_before": _in_words(plain),
        "E_after": _in_words(after),
    }
    truth = {**answer, "amplitudes": amplitudes(name, answer, effects)}
    return ScoredRound(
        scored=scored(row, {"kind": kind, "attempts": [truth]}),
        fruit=fruit_of(name, case),
        stored=case,
        error=error,
        linear=linear,
        explanations=tuple(explanations),
        detection=detection,
    )


def posterior(explanations: Sequence[Hypothesis]) -> list[tuple[str, float]]:
    """Names with their probabilities, likeliest first; "unknown" is among them."""
    return [(hypothesis.name, hypothesis.probability) for hypothesis in ranked(explanations)]


def _in_words(modulus: Modulus) -> dict[str, Any]:
    spread = NINETY * modulus.sd
    return {"value": modulus.value, "interval": [modulus.value - spread, modulus.value + spread]}


def amplitudes(name: str, answer: Mapping[str, Any], effects: Sequence[str]) -> dict[str, float]:
    """Of the true effects that have one. A wrong Poisson's ratio counts from the true one, and what the case
    states is drawn again.
    """
    added, without = tuple(answer.get("drawn_from", {}).get("added", ())), {}
    if {"poisson_ratio"} <= {*effects} & {*added}:
        drawn, _ = added_effects(name, added)
        without["poisson_ratio"] = next(
            effect.number("nu") for effect in drawn if effect.effect == "poisson_ratio"
        )
    return amplitudes_of(effects, answer["parameters"], **without)
