"""From fits to what an answer says: parameters with intervals, moduli, traces."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import ParameterSpec, Response
from fem.mismatch.evidence import Products, Recorded
from fem.mismatch.explanation import Candidate, GraspTrace, Modulus, Parameter
from fem.mismatch.ground import Ground
from fem.mismatch.lookalikes import seeming_spread
from fem.mismatch.name import Named, Ranked
from fem.mismatch.pads import pad_force
from fem.mismatch.prove import predictive
from fem.mismatch.refit import Refit
from fem.mismatch.singles import LinearRound
from fem.modulus_fit import fit_compliance

NINETY = 1.645
LEAST_RELATIVE_SD = 0.01
SCATTER = 0.02
"""Relative scatter of one recording's E, where there is no second one to show it."""
STEP = 0.1
"""Difference step in standard deviations of a parameter."""
SYSTEMATIC = 1.5
"""Standard deviations are this many times those of the thinned noise (fem.mismatch.normal)."""


def modulus_of(ground: Ground, response: Response | None = None) -> Modulus:
    """E by least squares over all markers of each recording, their mean; with an effect's response in place.

    The standard deviation: scatter between recordings, and LEAST_RELATIVE_SD for what they have in common.
    """
    found = []
    for k, seen in enumerate(ground.base.grasps):
        tracks = seen.tracks
        if response is not None:
            shift = 0.0 if response.shift_mm is None else response.shift_mm[k]
            tracks = replace(
                tracks, unit_displacement=response.unit[k], position_mm=tracks.position_mm - shift
            )
        fit = fit_compliance(
            tracks,
            scale_sd=ground.base.case.budget.gel_scale_sd,
            fruit_moves=seen.case.support == "free",
        )
        found.append(max(fit.compliance, 1e-9))
    logs = -np.log(found)
    value = float(np.exp(logs.mean()))
    scatter = float(logs.std(ddof=1) / np.sqrt(len(logs))) if len(logs) > 1 else SCATTER
    return Modulus(value=value, sd=value * float(np.hypot(scatter, LEAST_RELATIVE_SD)))


@dataclass(frozen=True, kw_only=True)
class _ModulusWith:
    """E with a refitted explanation in place: at its parameters (`at`), and all in all (`known`).

    `sd`: of the parameters, `change`: d ln E / d parameter, both on the scale searched.
    """

    at: Modulus
    known: Modulus
    sd: Float[np.ndarray, " p"]
    change: Float[np.ndarray, " p"]


def _modulus_with(again: Refit) -> _ModulusWith:
    """What the parameters are off by (their covariance, the model's error) is in the modulus' spread."""
    plain = modulus_of(again.ground, again.response)
    own = _own_error(again)
    laws = SYSTEMATIC**2 * again.fit.covariance[-len(own) :, -len(own) :] + np.diag(own**2)
    sd = np.sqrt(np.diag(laws))
    change = np.array(
        [
            np.log(modulus_of(again.ground, _moved_on(again, k, STEP * sd[k])).value / plain.value)
            / (STEP * sd[k])
            for k in range(len(sd))
        ]
    )
    spread = float(np.sqrt(change @ laws @ change))
    return _ModulusWith(
        at=plain,
        known=replace(plain, sd=float(np.hypot(plain.sd, plain.value * spread))),
        sd=np.hypot(SYSTEMATIC * np.sqrt(np.diag(again.covariance)), own),
        change=change,
    )


def _moved_on(again: Refit, number: int, step: float) -> Response:
    """The response with one parameter a step on, to first order.

    A slope is of 1/E times the unit response and of the shift together; where there is a shift, which of both
    changes is asked of the effect itself.
    """
    here = again.response
    if here.shift_mm is None:
        slope = again.products.columns[again.slopes[number]].fields
        unit = [
            own
            if field is None or field.markers is None
            else own + step / again.ground.compliance * field.markers
            for own, field in zip(here.unit, slope, strict=True)
        ]
        return replace(here, unit=unit)
    for effect, choice, values in zip(again.effects, again.choices, again.parameters, strict=True):
        if number >= len(effect.parameters):
            number -= len(effect.parameters)
            continue
        spec = effect.parameters[number]
        own = values[spec.name]
        on = {**values, spec.name: own * np.exp(step) if spec.log else own + step}
        before, after = (effect.respond(again.ground, at, choice) for at in (values, on))
        unit = [u + b - a for u, a, b in zip(here.unit, before.unit, after.unit, strict=True)]
        shift = here.shift_mm
        if before.shift_mm is not None and after.shift_mm is not None:
            shift = [u + b - a for u, a, b in zip(shift, before.shift_mm, after.shift_mm, strict=True)]
        return replace(here, unit=unit, shift_mm=shift)
    raise IndexError(number)


def _own_error(again: Refit) -> Float[np.ndarray, " p"]:
    """What the model's own error makes of each parameter, on the scale searched."""
    found = []
    for effect, values in zip(again.effects, again.parameters, strict=True):
        for spec in effect.parameters:
            value = values[spec.name]
            off = [spec.model_sd, spec.model_share * value, seeming_spread(effect)]
            found.append(np.linalg.norm(off) / (value if spec.log else 1.0))
    return np.array(found)


def candidates(ground: Ground, found: Named, linear: LinearRound) -> tuple[Candidate, ...]:
    """The ranking, with parameters where an effect was refitted."""
    base = predictive(linear.products, linear.nuisances)
    return tuple(_candidate(ground, one, linear, base) for one in found.ranking)


def _candidate(ground: Ground, one: Ranked, linear: LinearRound, base: float | None) -> Candidate:
    if one.refit is None:
        drop = sum(shown.chi2_drop for shown in one.shown)
        return Candidate(
            effect=one.name, probability=one.probability, parameters={}, log_evidence=one.gain, gain=drop
        )
    again = one.refit
    held = predictive(again.products, (*again.nuisances, *again.slopes))
    modulus = _modulus_with(again)
    return Candidate(
        effect=one.name,
        probability=one.probability,
        parameters=_parameters(ground, again, modulus),
        log_evidence=one.gain,
        gain=linear.null.chi2 - again.fit.chi2,
        heldout=None if held is None or base is None else held - base,
        refitted=True,
        modulus=modulus.known,
    )


def _parameters(ground: Ground, again: Refit, modulus: _ModulusWith) -> dict[str, Parameter]:
    several = len(again.effects) > 1
    found: dict[str, Parameter] = {}
    first = 0
    for effect, choice, values in zip(again.effects, again.choices, again.parameters, strict=True):
        prefix = f"{effect.name}." if several else ""
        if choice in _pads(ground):
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
                ends = _ninety(value, spread, logarithmic=spec.log)
                found[prefix + name] = Parameter(value=value, sd=spread, unit=unit, interval=ends)
        first += len(effect.parameters)
    return found


def _ninety(value: float, spread: float, *, logarithmic: bool) -> tuple[float, float]:
    """The interval of 90 %, about the value or about its logarithm."""
    if logarithmic:
        return value * math.exp(-NINETY * spread / value), value * math.exp(NINETY * spread / value)
    return value - NINETY * spread, value + NINETY * spread


def _said(
    spec: ParameterSpec, value: float, number: int, modulus: _ModulusWith
) -> tuple[str, float, str, float]:
    """Name, value, unit and spread as an answer gives them."""
    size = value if spec.log else 1.0
    spread = float(size * modulus.sd[number])
    if spec.name == "Et_over_E_mm":  # the membrane against the flesh is what shows, and E goes with it
        E = modulus.at
        own = (E.value + value * E.value * modulus.change[number] / size) * spread
        return "Et_N_per_mm", value * E.value, "N/mm", float(np.hypot(own, value * E.sd))
    return spec.name, value, spec.unit, spread


def _pads(ground: Ground) -> set[str]:
    return {pad for seen in ground.base.grasps for pad in seen.pad_names}


def traces(
    ground: Ground,
    recorded: Sequence[Recorded],
    before: tuple[Products, Sequence[int]],
    after: tuple[Products, Sequence[int]],
) -> tuple[GraspTrace, ...]:
    """Every recording through the fit of the others (its own where it is the only one)."""
    count = len(recorded)
    found = []
    for k, one in enumerate(recorded):
        others = [j for j in range(count) if j != k] or [k]
        seen = one.seen
        pads = range(len(seen.links))
        normals = np.stack([seen.pose[pad][0, :3, 2] for pad in pads])[seen.pad_of_marker]
        touching = seen.tracks.episode >= 0
        weight = touching / np.maximum(touching.sum(axis=1, keepdims=True), 1)
        response = ground.compliance * seen.tracks.unit_displacement

        def approach(
            field: np.ndarray, normals: np.ndarray = normals, weight: np.ndarray = weight
        ) -> np.ndarray:
            return np.asarray(np.einsum("fnx,nx,fn->f", field, normals, weight))

        plain = approach(response)
        left = [
            approach(products.beyond(k, products.fit(columns, keep=others)))
            for products, columns in (before, after)
        ]
        force = np.mean([np.linalg.norm(pad_force(seen, pad), axis=1) for pad in pads], axis=0)
        phase = tuple(p for p, used in zip(seen.case.history.phase, seen.used, strict=True) if used)
        found.append(
            GraspTrace(
                grasp=seen.case.name,
                time_s=seen.time_s,
                phase=phase,
                force_N=force,
                given_mm=plain + left[0],
                before_mm=plain,
                after_mm=plain + left[0] - left[1],
            )
        )
    return tuple(found)
