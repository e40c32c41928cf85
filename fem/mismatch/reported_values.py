"""From fits to what an answer says: parameters with intervals, moduli, traces."""

import math
from collections.abc import Sequence

import numpy as np

from fem.mismatch.effect import ParameterSpec
from fem.mismatch.evidence.linear_evidence import GramMatrix, GraspEquations
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.pads import pad_force
from fem.mismatch.result import Candidate, GraspTrace, Parameter
from fem.mismatch.selection.cross_validation import predictive
from fem.mismatch.selection.model_selection import Hypothesis, ModelSelection
from fem.mismatch.selection.modulus_with import ModulusWith, modulus_with
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.screening import LinearRound

NINETY = 1.645
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""


def candidates(forward: ForwardModel, found: ModelSelection, linear: LinearRound) -> tuple[Candidate, ...]:
    """The ranking, with parameters where an effect was refitted."""
    base = predictive(linear.products, linear.nuisances)
    return tuple(_candidate(forward, one, linear, base) for one in found.ranking)


def _candidate(forward: ForwardModel, one: Hypothesis, linear: LinearRound, base: float | None) -> Candidate:
    """One hypothesis as the result has it; without parameters and modulus where it was not refitted."""
    if one.refit is None:
        drop = sum(shown.chi2_drop for shown in one.shown)
        return Candidate(
            effect=one.name, probability=one.probability, parameters={}, log_evidence=one.gain, gain=drop
        )
    again = one.refit
    held = predictive(again.products, (*again.nuisances, *again.slopes))
    modulus = modulus_with(again)
    return Candidate(
        effect=one.name,
        probability=one.probability,
        parameters=_parameters(forward, again, modulus),
        log_evidence=one.gain,
        gain=linear.null.chi2 - again.fit.chi2,
        heldout=None if held is None or base is None else held - base,
        refitted=True,
        modulus=modulus.known,
    )


def _parameters(forward: ForwardModel, again: Refit, modulus: ModulusWith) -> dict[str, Parameter]:
    """A refit's parameters by name, with standard deviation and 90 % interval; vectors are joined again."""
    several = len(again.effects) > 1
    found: dict[str, Parameter] = {}
    first = 0
    for effect, choice, values in zip(again.effects, again.choices, again.parameters, strict=True):
        prefix = f"{effect.name}." if several else ""
        if choice in _pads(forward):
            found[f"{prefix}pad"] = Parameter(value=choice, sd=None, unit="")
        vectors: dict[str, list[tuple[float, float]]] = {}
        for k, spec in enumerate(effect.parameters):
            name, value, unit, spread = _said(spec, values[spec.name], first + k, modulus)
            stem, _, component = name.partition(".")
            if component:
                vectors.setdefault(stem, []).append((value, spread))
                found[prefix + stem] = Parameter(
                    value=tuple(v for v, _ in vectors[stem]), sd=tuple(s for _, s in vectors[stem]), unit=unit
                )
            else:
                ends = _ninety(value, spread, spec, scale=value / values[spec.name] if value else 1.0)
                found[prefix + name] = Parameter(value=value, sd=spread, unit=unit, interval=ends)
        first += len(effect.parameters)
    return found


def _ninety(value: float, spread: float, spec: ParameterSpec, *, scale: float = 1.0) -> tuple[float, float]:
    """The interval of 90 %, about the value or about its logarithm; `scale`: unit of the bounds, as said."""
    if spec.log:
        return value * math.exp(-NINETY * spread / value), value * math.exp(NINETY * spread / value)
    low, high = value - NINETY * spread, value + NINETY * spread
    return max(low, scale * spec.low), min(high, scale * spec.high)


def _said(
    spec: ParameterSpec, value: float, number: int, modulus: ModulusWith
) -> tuple[str, float, str, float]:
    """Name, value, unit and spread as an answer gives them."""
    size = value if spec.log else 1.0
    spread = float(size * modulus.sd[number])
    if spec.name == "Et_over_E_mm":  # the membrane against the flesh is what shows, and E goes with it
        E = modulus.at
        own = (E.value + value * E.value * modulus.change[number] / size) * spread
        return "Et_N_per_mm", value * E.value, "N/mm", float(np.hypot(own, value * E.sd))
    return spec.name, value, spec.unit, spread


def _pads(forward: ForwardModel) -> set[str]:
    return {pad for recording in forward.base.grasps for pad in recording.pad_names}


def traces(
    forward: ForwardModel,
    recorded: Sequence[GraspEquations],
    before: tuple[GramMatrix, Sequence[int]],
    after: tuple[GramMatrix, Sequence[int]],
) -> tuple[GraspTrace, ...]:
    """Every recording through the fit of the others (its own where it is the only one)."""
    count = len(recorded)
    found = []
    for k, one in enumerate(recorded):
        others = [j for j in range(count) if j != k] or [k]
        recording = one.recording
        pads = range(len(recording.links))
        normals = np.stack([recording.pose[pad][0, :3, 2] for pad in pads])[recording.pad_of_marker]
        touching = recording.tracks.episode >= 0
        weight = touching / np.maximum(touching.sum(axis=1, keepdims=True), 1)
        response = forward.compliance * recording.tracks.unit_displacement

        def approach(
            field: np.ndarray, normals: np.ndarray = normals, weight: np.ndarray = weight
        ) -> np.ndarray:
            return np.asarray(np.einsum("fnx,nx,fn->f", field, normals, weight))

        plain = approach(response)
        left = [
            approach(products.beyond(k, products.fit(columns, keep=others)))
            for products, columns in (before, after)
        ]
        force = np.mean([np.linalg.norm(pad_force(recording, pad), axis=1) for pad in pads], axis=0)
        phase = tuple(p for p, used in zip(recording.case.history.phase, recording.used, strict=True) if used)
        found.append(
            GraspTrace(
                grasp=recording.case.name,
                time_s=recording.time_s,
                phase=phase,
                force_N=force,
                given_mm=plain + left[0],
                before_mm=plain,
                after_mm=plain + left[0] - left[1],
            )
        )
    return tuple(found)
