"""A grasp's model with large deformation: what hyperelastic flesh does beyond the linear answer."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import fit_compliance
from fem.estimation.finite_strain_correction import MarkerContact, finite_modulus
from fem.estimation.frame_thinning import loaded_frames
from fem.estimation.grasp_model import GraspModel
from fem.estimation.modulus import require_positive, tracks_compare
from fem.estimation.unit_response import marker_tracks
from fem.grasp_history import GraspHistory
from fem.materials.law import UnitLaw
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import UnitModulusSolid


def with_large_deformation(
    model: GraspModel, history: GraspHistory, solid: UnitModulusSolid, law: UnitLaw, *, scale_sd: float
) -> GraspModel:
    """The model with its correction in every frame used, at the modulus that it then gives itself.

    `solid` is the one the model was made from, `scale_sd` as in fem.estimation.compliance_fit. Raises
    FemFailure:
    not-converged (at which share of the load), no-modulus, no-load.
    """
    loaded = loaded_frames(history)
    tracks, force_N = marker_tracks(history, model, loaded)

    def compliance(unit_displacement: Float[np.ndarray, "t n 3"]) -> float:
        bent = replace(tracks, unit_displacement=unit_displacement)
        return fit_compliance(bent, scale_sd=scale_sd, fruit_moves=model.fruit_moves).compliance

    if not tracks_compare(tracks):
        return model  # the absolute form has no use for it
    _, found = finite_modulus(
        FiniteStrainSolid(solid=solid, law=law),
        MarkerContact.of(history, solid),
        force_N,
        tracks.unit_displacement,
        modulus_MPa=require_positive(compliance(tracks.unit_displacement)),
        refit=compliance,
    )
    displacement_correction = np.zeros((len(loaded), *model.place_mm.shape))
    displacement_correction[loaded] = found.displacement_correction
    return replace(model, displacement_correction=displacement_correction)
