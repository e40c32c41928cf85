"""A recording's equations at the model's compliance, and whether gels stick: formed once for all fits."""

from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, BalanceEquations, MarkerEquations
from fem.mismatch.model.pulling_markers import LEAST_EVIDENCE, Pull

NEWTON_PER_MM3 = 9.81e-6
"""Weight of flesh, which floats or just sinks in water."""
STICK_KEY = "gels stick"
"""Under which a model remembers whether they do."""


def marker_equations(forward: ForwardModel, recording: GraspResponse) -> MarkerEquations:
    """Those of its markers, with the case's own spread of marker scales.

    A frame of a thinned recording stands for those left out beside it: with it fewer numbers count as one.
    """

    def compute() -> MarkerEquations:
        gel_scale_sd = forward.base.case.budget.gel_scale_sd
        return MarkerEquations.of(
            recording,
            compliance=forward.compliance,
            gel_scale_sd=gel_scale_sd,
            design_effect=max(DESIGN_EFFECT * recording.kept, 1.0),
        )

    return forward.memoised(("marker equations", recording.case.name, forward.compliance), compute)


def balance_equations(forward: ForwardModel, recording: GraspResponse) -> BalanceEquations | None:
    """Those of its forces, where nothing but several pads holds the fruit; its weight is a nuisance.

    Whether gels stick, so that what they pull with is noise, all recordings of the fruit say together.
    """

    def compute() -> BalanceEquations | None:
        if recording.case.support != "free" or len(recording.links) < 2:
            return None
        weight_N = NEWTON_PER_MM3 * float(forward.points.volume_mm3.sum())
        return BalanceEquations.of(recording, weight_N=weight_N, gels_stick=gels_stick(forward))

    return forward.memoised(("balance equations", recording.case.name), compute)


def pull_of(forward: ForwardModel) -> Pull:
    """How far gels are pulled away from the skin, all recordings of the fruit together; computed once."""
    cases = [recording.case for recording in forward.base.grasps]
    return forward.memoised("pulling markers", lambda: Pull.of(cases))


def gels_stick(forward: ForwardModel) -> bool:
    """Whether gels stick to the fruit, by all its recordings together: one alone may have few that pull."""
    return forward.memoised(STICK_KEY, lambda: pull_of(forward).evidence > LEAST_EVIDENCE)
