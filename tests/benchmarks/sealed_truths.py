"""Labels and answers of made-up sealed cases, whose scores are known."""

from typing import Any


def label(
    kind: str, effect: str, *, amplitude: float = 1.0, E: float = 0.5, **parameters: Any
) -> dict[str, Any]:
    """A label with one attempt."""
    effects = [] if effect in ("none", "unknown") else effect.split("+")
    truth = {
        "effect": effect,
        "parameters": parameters,
        "E_MPa": E,
        "amplitudes": dict.fromkeys(effects, amplitude),
    }
    return {"kind": kind, "attempts": [truth]}


def row(
    case: str,
    verdict: list[str],
    *,
    p: float = 0.5,
    first: str = "none",
    probability: float = 0.9,
    parameters: dict[str, Any] | None = None,
    E: tuple[float, float] = (0.5, 0.01),
    signal: float = 20.0,
    **more: Any,
) -> dict[str, Any]:
    """An answer whose first name is `first`."""
    value, sd = E
    modulus = {"value": value, "sd": sd, "interval": [value - 1.645 * sd, value + 1.645 * sd]}
    named = {
        "effect": first,
        "probability": probability,
        "log_evidence": 30.0,
        "refitted": True,
        "E": modulus,
        "parameters": parameters or {},
    }
    none = {**named, "effect": "none", "probability": 1 - probability, "parameters": {}}
    return {
        "case": case,
        "attempt": 0,
        "peaks_N": [10.0, 8.0],
        "code": "0",
        "verdict": verdict,
        "detected": verdict != ["none"],
        "p": p,
        "ranking": [named, none] if first != "none" else [none],
        "E_before": modulus,
        "E_after": modulus,
        "chi2": 100.0 + signal**2,
        "chi2_usual": 100.0,
        "cpu_s": 100.0,
        **more,
    }
