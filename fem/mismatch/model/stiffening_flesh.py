"""Flesh by the law of fem.materials.fung_neo_hookean under the forces of all recordings, in full."""

import numpy as np
from jaxtyping import Float

from fem.materials.fung_neo_hookean import fung_neo_hookean, shrunk_as_a_whole
from fem.materials.strain_path import strain_energy
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.stress_history import PathState, fixed_point, path_state

FRAMES = 24
"""Frames of all recordings together."""
HARDLY_ANY = 0.1
"""A b that hardly stiffens: W/mu is a hundredth where strains are a tenth, and flesh by the law is then
Neo-Hookean."""


def stiffening_path(model: CaseModel) -> PathState:
    """The frames on which the law is followed."""
    return path_state(model, frames=FRAMES, remembers=False)


def beyond_linear(model: CaseModel, b: float) -> Float[np.ndarray, "f n 3"]:
    """v - v0 (fem.solid.initial_stress), from the linear field shrunk as a whole or a search's own solution.

    Finite strain, dead loads on the unloaded skin. Raises FemFailure (NOT_CONVERGED).
    """
    nu, s = model.poisson_ratio, model.compliance
    state, pieces = stiffening_path(model), model.pieces
    energy = pieces.measured(s * state.linear, lambda gradient: strain_energy(gradient, poisson_ratio=nu))
    shrunk, steepest = shrunk_as_a_whole(energy, pieces.volume_mm3, b, poisson_ratio=nu)
    return fixed_point(
        model,
        state,
        fung_neo_hookean(b, poisson_ratio=nu),
        name="stiffening",
        place=np.log([b * s**2, s]),
        together=False,
        start=(shrunk - 1)[:, None, None] * state.linear,
        stiffer=steepest,
    )
