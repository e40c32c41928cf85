"""One explanation against the truth of its case."""

from typing import Any

import numpy as np
from parameter_errors import NINETY, PLACES, parameter_errors

from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import NONE, UNKNOWN, Candidate, Explanation, Modulus

FAMILY = {name: spec.family for name, spec in SPECS.items()}


def score(found: Explanation, truth: dict[str, Any]) -> dict[str, Any]:
    """Everything that is counted of one case, as plain JSON values; None where it does not apply."""
    name = joined(truth["effect"])
    verdict = [joined(one) for one in ([found.verdict] if isinstance(found.verdict, str) else found.verdict)]
    order = [joined(one.effect) for one in found.ranking if one.effect != NONE]
    named = name not in (NONE, UNKNOWN)
    says_a_name = found.detected and verdict != [UNKNOWN]
    parts = name.split("+")
    own = next((one for one in found.ranking if joined(one.effect) == name and one.refitted), None)
    E = float(truth["E_MPa"])
    return {
        "verdict": verdict,
        "truth": name,
        "p_value": found.p_value,
        "detected": found.detected,
        "right_first": (says_a_name and order[:1] == [name]) if named else verdict == [name],
        "right_in_two": says_a_name and name in order[:2] if named else None,
        "in_set": name in verdict,
        "set_size": len(verdict),
        "family_right": _family(order, parts) if named and says_a_name else (False if named else None),
        "one_of_two": any(part in one.split("+") for part in parts for one in verdict)
        if len(parts) > 1
        else None,
        "E_true_MPa": E,
        "E_before_MPa": found.before.value,
        "E_after_MPa": found.after.value,
        "E_before_error": found.before.value / E - 1,
        "E_after_error": found.after.value / E - 1,
        "E_before_inside": _holds(found.before, E),
        "E_after_inside": _holds(found.after, E),
        "parameters": _parameters(own, parts, truth) if own else [],
        "centre_off_mm": _centre_off(own, truth) if own else None,
        "heldout_before": found.heldout.rms_before if found.heldout else None,
        "heldout_after": found.heldout.rms_after if found.heldout else None,
        "heldout_noise": found.heldout.noise_rms if found.heldout else None,
        "statistics": found.statistics,
        "ranking": [[joined(one.effect), one.probability, one.log_evidence] for one in found.ranking[:6]],
        "stages": found.seconds or {},
    }


def joined(name: str) -> str:
    """Effects at work together, sorted."""
    return "+".join(sorted(name.split("+")))


def _true(truth: dict[str, Any]) -> dict[str, Any]:
    """Parameters by name; those of several effects, which an answer keeps in groups, as "effect.name"."""
    flat: dict[str, Any] = {}
    for name, value in truth["parameters"].items():
        flat |= (
            {f"{name}.{key}": own for key, own in value.items()} if isinstance(value, dict) else {name: value}
        )
    return flat


def _family(order: list[str], parts: list[str]) -> bool:
    if not order:
        return False
    return {FAMILY.get(part) for part in order[0].split("+")} == {FAMILY.get(part) for part in parts}


def _holds(modulus: Modulus, truth: float) -> bool:
    return bool(abs(modulus.value - truth) <= NINETY * modulus.sd)


def _parameters(own: Candidate, parts: list[str], truth: dict[str, Any]) -> list[dict[str, Any]]:
    """Value and truth of each parameter that formats define; of a number its error, and if 90 % hold it."""
    said = {name: vars(parameter) for name, parameter in own.parameters.items()}
    found = parameter_errors(parts, said, _true(truth))
    return [
        {"name": one.name, "value": one.value, "truth": one.truth}
        | ({} if one.error is None else {"error": one.error, "inside": list(one.inside)})
        for one in found
    ]


def _centre_off(own: Candidate, truth: dict[str, Any]) -> float | None:
    known = _true(truth)
    for key, parameter in own.parameters.items():
        if key.endswith(PLACES) and key in known and isinstance(parameter.value, tuple):
            return float(np.linalg.norm(np.subtract(parameter.value, known[key])))
    return None
