"""What large deformation adds to the plain model: the response of Neo-Hookean flesh less the linear one.

All soft flesh deforms largely under the forces of a grasp: two millimetres of indentation under a patch of
six strain it by a fifth. The plain model's strains are small, and what it leaves out looks like a skin or
like stiffening with hardly any b (10 to 69 nats on sound fruit of 0.2 to 0.4 MPa, first blind test).
"""

from collections.abc import Collection

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.stiffening_flesh import HARDLY_ANY, beyond_linear, stiffening_path

LARGE_DEFORMATION = "large deformation"
"""Name of its column."""
MEAN, SD = 1.0, 0.25
"""Prior of its amount: all real flesh deforms largely. Set by hand: where any amount is allowed, Neo-Hookean
fruit of simulators have 0.5 to 0.9 of this second-order response."""


def large_deformation(forward: ForwardModel) -> list[Float[np.ndarray, "_f _n 3"]] | FemFailure | None:
    """What it adds to the unit response at the markers of every recording, mm MPa.

    None where the plain model holds it already (`leave_large_deformation`, or `leave_finite_strain` of all
    recordings); the failure where flesh is so soft that the search from the linear answer does not settle.
    """

    def compute() -> list[Float[np.ndarray, "_f _n 3"]] | FemFailure | None:
        if at_finite_strain(forward) >= {recording.case.name for recording in forward.base.grasps}:
            return None
        try:
            return stiffening_path(forward).at_markers(beyond_linear(forward, HARDLY_ANY))
        except FemFailure as failure:
            return failure

    return forward.memoised(_KEY, compute)


def leave_large_deformation(forward: ForwardModel) -> None:
    """Takes the plain model's response as it is."""
    forward.memoised(_KEY, lambda: None)


def leave_finite_strain(forward: ForwardModel, recordings: Collection[str]) -> None:
    """Takes the response of these recordings, by name, as it is: it is at finite strain and holds the fruit's
    turn (fem.estimation.finite_response).
    """
    forward.memoised(_FINITE, lambda: frozenset(recordings))


def at_finite_strain(forward: ForwardModel) -> frozenset[str]:
    """Names of the recordings whose plain response is at finite strain already."""
    return forward.memoised(_FINITE, frozenset)


_KEY, _FINITE = "large deformation", "recordings at finite strain"
