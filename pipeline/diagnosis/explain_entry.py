"""The answer of the finder as the entry that JSON, page and terminal are written from."""

from collections.abc import Mapping
from dataclasses import fields
from datetime import datetime

from fem.mismatch.result import Explanation
from pipeline.diagnosis.diagnosis import Diagnosis
from pipeline.diagnosis.effect_entries import effect_entries, parameter_words
from reports.explain_entries import ExplainEntry


def explain_entry(
    found: Diagnosis,
    *,
    case: str,
    category: str,
    seconds: Mapping[str, float],
    inputs: Mapping[str, str],
    versions: Mapping[str, str],
    made: datetime,
    applied: str = "",
) -> ExplainEntry:
    """All that is written of one case. Fields of one name are taken over by it (`seconds` excepted); the
    finder's `before`, `after` and `heldout` are the entry's `E_MPa` and `fit`.
    """
    answer = found.explanation
    return ExplainEntry.model_validate(
        {
            **{field.name: getattr(answer, field.name) for field in fields(answer)},
            "E_MPa": {"before": answer.before, "after": answer.after},
            "fit": answer.heldout or {},
            "seconds": seconds,
            "case": case,
            "category": category,
            "grasps": found.grasps,
            "applied": applied or None,
            "inputs": inputs,
            "versions": versions,
            "made_utc": made,
            "effects": effect_entries([*_names(answer), *(one.effect for one in answer.ranking)]),
            "parameter_words": {
                one.effect: {name: parameter_words(one.effect, name) for name in one.parameters}
                for one in answer.ranking
            },
            "contacts_mm": found.contacts_mm,
            "facts": found.facts,
            "doubts": found.doubts,
        },
    )


def _names(answer: Explanation) -> tuple[str, ...]:
    return (answer.verdict,) if isinstance(answer.verdict, str) else answer.verdict
