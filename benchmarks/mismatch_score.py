"""One explanation against the truth of its case."""

from typing import Any

import numpy as np

from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import NONE, UNKNOWN, Candidate, Explanation, Modulus, Parameter

NINETY = 1.645
FAMILY = {name: spec.family for name, spec in SPECS.items()}
PLACE = "centre_mm"


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
    """Each parameter that formats define: value, truth, relative error, inside its 90 % interval."""
    rows, known = [], _true(truth)
    for effect in parts:
        for name in (parameter.name for parameter in SPECS[effect].parameters) if effect in SPECS else ():
            key = f"{effect}.{name}" if len(parts) > 1 else name
            if key not in own.parameters or key not in known or name == PLACE:
                continue
            parameter, true = own.parameters[key], known[key]
            if isinstance(true, str):
                rows.append({"name": f"{effect}.{name}", "value": parameter.value, "truth": true})
                continue
            value, wanted = (np.atleast_1d(np.array(x, dtype=float)) for x in (parameter.value, true))
            rows.append(
                {
                    "name": f"{effect}.{name}",
                    "value": parameter.value,
                    "truth": true,
                    "error": float(
                        np.linalg.norm(value - wanted)
                        / np.linalg.norm(wanted)
                        * (np.sign(value[0] - wanted[0]) if len(value) == 1 else 1)
                    ),
                    "inside": _inside(parameter, value, wanted),
                }
            )
    return rows


def _inside(parameter: Parameter, value: np.ndarray, truth: np.ndarray) -> list[bool]:
    """Of each component."""
    if parameter.interval is not None:
        low, high = parameter.interval
        return [bool(low <= truth[0] <= high)]
    if parameter.sd is None:
        return []
    spread = NINETY * np.atleast_1d(np.array(parameter.sd, dtype=float))
    return [bool(x) for x in np.abs(value - truth) <= spread]


def _centre_off(own: Candidate, truth: dict[str, Any]) -> float | None:
    known = _true(truth)
    for key, parameter in own.parameters.items():
        if key.endswith(PLACE) and key in known and isinstance(parameter.value, tuple):
            return float(np.linalg.norm(np.subtract(parameter.value, known[key])))
    return None
