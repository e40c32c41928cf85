"""A recording's marker equations at the plain model's compliance, made once for all that fit with them."""

from fem.mismatch.baseline import Seen
from fem.mismatch.ground import Ground
from fem.mismatch.normal import MarkerEquations


def marker_equations(ground: Ground, seen: Seen) -> MarkerEquations:
    """Those of its markers, with the case's own spread of marker scales."""

    def compute() -> MarkerEquations:
        gel_scale_sd = ground.base.case.budget.gel_scale_sd
        return MarkerEquations.of(seen, compliance=ground.compliance, gel_scale_sd=gel_scale_sd)

    return ground.kept(("marker equations", seen.case.name), compute)
