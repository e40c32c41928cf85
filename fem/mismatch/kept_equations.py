"""A recording's equations at the plain model's compliance, made once for all effects that fit with them."""

from fem.mismatch.baseline import Seen
from fem.mismatch.evidence import Recorded
from fem.mismatch.ground import Ground
from fem.mismatch.normal import MarkerEquations


def marker_equations(ground: Ground, seen: Seen) -> MarkerEquations:
    """Those of its markers."""
    return ground.kept(("marker equations", seen.case.name), lambda: Recorded.of(ground, seen).markers)
