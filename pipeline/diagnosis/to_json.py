"""The finder's answer as the JSON that formats name, and as what the page is told."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import datetime
from typing import Any

import numpy as np
from jaxtyping import Float

from fem.mismatch.result import Candidate, Explanation, Modulus, Parameter
from pipeline.diagnosis.effect_entries import effect_entries, parameter_words
from reports.explain_entries import (
    CandidateEntry,
    CellEntry,
    CheckEntry,
    ExplainEntry,
    MapEntry,
    ParameterEntry,
    TraceEntry,
    VarianceEntry,
)

FORMAT, VERSION = "drupe-mismatch", 1
"""Name and number of the format that docs/formats.md describes; the number grows when an old reader would
fail."""
IN_ALL = "in all"
"""The name of the whole run's time among its stages'."""


def answer(found: Explanation, *, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The answer as plain JSON values, no NaN; the keys of the format first, then more, `facts` last."""
    fit = found.heldout
    said = {
        "format": FORMAT,
        "version": VERSION,
        "detected": found.detected,
        "p_value": found.p_value,
        "where": {
            "region": found.where.region,
            "centre_mm": found.where.centre_mm,
            "radius_mm": found.where.radius_mm,
        },
        "when": found.when,
        "component": found.component,
        "ranking": [_candidate(one) for one in found.ranking],
        "verdict": found.verdict,
        "E_MPa": {"before": _modulus(found.before), "after": _modulus(found.after)},
        "fit": {
            "heldout_rms_before": fit.rms_before if fit else None,
            "heldout_rms_after": fit.rms_after if fit else None,
            "noise_rms": fit.noise_rms if fit else None,
        },
        "next_grasp": found.next_grasp,
        "statistics": found.statistics,
        "variance": [_fields(row) for row in found.variance],
        "checks": [_fields(check) for check in found.checks],
        "notes": found.notes,
        "seconds": found.seconds or {},
        **facts,
    }
    plain: dict[str, Any] = _plain(said)
    return plain


def _candidate(one: Candidate) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "probability": one.probability,
        "parameters": {name: _parameter(parameter) for name, parameter in one.parameters.items()},
        "log_evidence": one.log_evidence,
        "chi2_gain": one.gain,
        "heldout_gain": one.heldout,
        "refitted": one.refitted,
        "E_MPa": _modulus(one.modulus) if one.modulus else None,
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    said = {"value": parameter.value, "sd": parameter.sd, "unit": parameter.unit}
    return said | ({"interval_90": parameter.interval} if parameter.interval else {})


def _modulus(modulus: Modulus) -> dict[str, float]:
    return {"value": modulus.value, "sd": modulus.sd}


def _fields(record: Any) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in fields(record)}


def _plain(value: Any) -> Any:
    """Python's own types, a number that is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def explain_entry(
    found: Explanation,
    *,
    name: str,
    category: str,
    grasps: Sequence[str],
    contacts_mm: Mapping[str, Float[np.ndarray, "p 3"]],
    made: datetime,
    facts: Sequence[tuple[str, str]] = (),
    inputs: Sequence[tuple[str, str]] = (),
    seconds: Mapping[str, float] | None = None,
    applied: str = "",
) -> ExplainEntry:
    """The same for the page."""
    fit, maps = found.heldout, found.maps
    verdict = (found.verdict,) if isinstance(found.verdict, str) else tuple(found.verdict)
    return ExplainEntry(
        name=name,
        category=category,
        detected=found.detected,
        p_value=found.p_value,
        verdict=verdict,
        region=found.where.region,
        centre_mm=found.where.centre_mm,
        radius_mm=found.where.radius_mm,
        when=found.when,
        component=found.component,
        ranking=tuple(map(_candidate_entry, found.ranking)),
        E_before_MPa=found.before.value,
        E_before_sd_MPa=found.before.sd,
        E_after_MPa=found.after.value,
        E_after_sd_MPa=found.after.sd,
        made_utc=made,
        effects=effect_entries([*verdict, *(one.effect for one in found.ranking)]),
        statistics=found.statistics,
        rms=(fit.rms_before, fit.rms_after, fit.noise_rms) if fit else None,
        next_grasp=found.next_grasp,
        cells=tuple(CellEntry(**_fields(cell)) for cell in found.cells),
        variance=tuple(VarianceEntry(**_fields(row)) for row in found.variance),
        traces=tuple(TraceEntry(**_fields(trace)) for trace in found.traces),
        checks=tuple(CheckEntry(**_fields(check)) for check in found.checks),
        map=MapEntry(**_fields(maps)) if maps else None,
        contacts_mm=contacts_mm,
        grasps=tuple(grasps),
        notes=found.notes,
        applied=applied,
        seconds=seconds or found.seconds or {},
        facts=tuple(facts),
        inputs=tuple(inputs),
    )


def _candidate_entry(one: Candidate) -> CandidateEntry:
    return CandidateEntry(
        effect=one.effect,
        probability=one.probability,
        log_evidence=one.log_evidence,
        chi2_gain=one.gain,
        heldout_gain=one.heldout,
        refitted=one.refitted,
        parameters=tuple(
            ParameterEntry(
                name=name,
                value=p.value,
                sd=p.sd,
                unit=p.unit,
                interval=p.interval,
                words=parameter_words(one.effect, name),
            )
            for name, p in one.parameters.items()
        ),
        E_MPa=one.modulus.value if one.modulus else None,
        E_sd_MPa=one.modulus.sd if one.modulus else None,
    )
