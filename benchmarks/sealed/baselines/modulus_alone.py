"""Baseline: E fitted by the plain model, and nothing else: no names, all residual stays."""

from typing import Any

from fem.mismatch.result import NONE, Modulus


def modulus_alone(E: Modulus) -> dict[str, Any]:
    """The answer for a case whose plain model has this E."""
    return {"verdict": [NONE], "order": [], "E": [E.value, E.sd], "heldout_ratio": 1.0}
