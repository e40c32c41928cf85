"""The finder's answer as the entry from which JSON, page and terminal are written."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from datetime import datetime

from fem.mismatch.catalogue import SPECS
from pipeline.diagnosis.diagnosis import Diagnosis
from reports.explain_entries import EffectEntry, ExplainEntry

OF_A_TRACE = {
    "onset_mm": "travel at first contact",
    "zero_N": "load cell reading before first contact",
    "toe_mm": "travel over which an end that is not parallel to its plate comes into contact",
    "ends_held": "ends of the specimen: 0 slide, 1 are held",
    "yeoh_second": "law of Yeoh: C2 / C1",
    "yeoh_third": "law of Yeoh: C3 / C1",
    "ogden_power": "law of Ogden: exponent of a term",
    "ogden_weight_2": "law of Ogden: share of the second term in the initial stiffness",
}
"""Parameters that only the curve of a bare indenter has; they belong to no effect."""


def explain_entry(
    diagnosis: Diagnosis,
    *,
    case: str,
    category: str,
    seconds: Mapping[str, float],
    inputs: Mapping[str, str],
    versions: Mapping[str, str],
    made: datetime,
    applied: str = "",
) -> ExplainEntry:
    """All output on one case. Fields of the explanation are copied by name (`seconds` excepted)."""
    answer = diagnosis.explanation
    verdict = (answer.verdict,) if isinstance(answer.verdict, str) else answer.verdict
    known = {field.name: getattr(answer, field.name) for field in fields(answer)}
    return ExplainEntry(
        **known
        | {
            "verdict": verdict,
            "left_out": tuple(diagnosis.grasps[k] for k in answer.left_out),
            "seconds": seconds,
            "case": case,
            "category": category,
            "grasps": diagnosis.grasps,
            "applied": applied or None,
            "inputs": inputs,
            "versions": versions,
            "made_utc": made,
            "effects": effect_entries([*verdict, *(candidate.effect for candidate in answer.ranking)]),
            "parameter_words": {
                candidate.effect: {
                    name: parameter_words(candidate.effect, name) for name in candidate.parameters
                }
                for candidate in answer.ranking
            },
            "contacts_mm": diagnosis.contacts_mm,
            "facts": diagnosis.facts,
            "doubts": diagnosis.doubts,
            "scale_sd": diagnosis.scale_sd,
        }
    )


def effect_entries(names: Iterable[str]) -> dict[str, EffectEntry]:
    """Words of all single effects in these names, those of pairs included, that the catalogue has."""
    single = dict.fromkeys(part for name in names for part in name.split("+"))
    return {name: EffectEntry(**vars(SPECS[name].words)) for name in single if name in SPECS}


def parameter_words(effect: str, name: str) -> str:
    """The meaning of a parameter of an effect or pair, where it may be named "effect.parameter".

    Further ones of a kind have the words of the first; unknown ones have their own name.

    >>> parameter_words("viscoelastic", "tau_2_s")
    'time over which it fades'
    """
    part, _, parameter_name = name.rpartition(".")
    specs = [
        SPECS[effect_name] for effect_name in ([part] if part else effect.split("+")) if effect_name in SPECS
    ]
    known = (spec.parameter(parameter_name) for spec in specs)
    words = next((parameter.words for parameter in known if parameter is not None), None)
    of_trace = next((said for prefix, said in OF_A_TRACE.items() if parameter_name.startswith(prefix)), None)
    return words or of_trace or name.replace("_", " ")
