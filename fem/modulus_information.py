"""What one recording knows of the modulus, and of everything else that moves the same markers.

The fit of fem.modulus_fit with more columns: beside s c the fields  s dC/dp f  of every cause p of
fem.grasp_sensitivity, and those of the markers' force scales, s C diag(f) h, h independent with a known
spread. Places, motions of the fruit and scales of the gel are eliminated; a small symmetric matrix is left.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.grasp_model import GraspModel
from fem.grasp_sensitivity import PIT
from fem.modulus_fit import Information, MarkerTracks, information

SCALE_MODES = 16
"""Patterns of force-scale errors that are kept: those that move the markers most."""
FORCE_SCALE = "force scale"
BLOCK_MM = 4.0
"""Size of the blocks of skin within which what the model leaves counts as one draw."""


@dataclass(frozen=True, kw_only=True)
class GraspInformation:
    """Normal equations N a = b of the amounts a = s (1, p_1, ..., h_1, ...), s = 1/E, per MPa.

    `causes` names all but the first: those of the sensitivity, then FORCE_SCALE as often as there are
    patterns.
    """

    causes: tuple[str, ...]
    normal: Float[np.ndarray, "k k"]
    right: Float[np.ndarray, " k"]

    @classmethod
    def of_modulus_alone(cls, compliance: float, *, relative_sd: float) -> "GraspInformation":
        """Of an estimate of s that says nothing of other causes."""
        weight = (relative_sd * compliance) ** -2
        return cls(causes=(), normal=np.array([[weight]]), right=np.array([weight * compliance]))


def grasp_information(
    tracks: MarkerTracks,
    model: GraspModel,
    force_N: Float[np.ndarray, "t n 3"],
    *,
    scale_sd: float,
    noise: tuple[float, float],
) -> GraspInformation:
    """The information of one recording, its noise taken as large as what the model leaves of it.

    `noise`: information about s that noise in the forces feigns, and the s that it shows
    (fem.modulus_force_noise); it is taken out.
    """
    patterns = _scale_patterns(model, force_N)
    felt = np.stack([model.unit_displacement(force_N * h[:, None]) for h in patterns])
    fields = np.concatenate([tracks.unit_displacement[None], model.sensitivity.values, felt])
    known = information(tracks, fields, scale_sd=scale_sd, fruit_moves=model.fruit_moves)
    normal, right = known.normal, known.right
    pit = [1 + k for k, cause in enumerate(model.sensitivity.causes) if cause in PIT]
    effect = _design_effect(known, model.place_mm, [0, *pit])
    feigned, shown = noise
    normal[0, 0] -= feigned
    right[0] -= feigned * shown
    return GraspInformation(
        causes=(*model.sensitivity.causes, *len(patterns) * (FORCE_SCALE,)),
        normal=normal / effect,
        right=right / effect,
    )


def _scale_patterns(model: GraspModel, force_N: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "k n"]:
    """Orthonormal patterns of marker scales, those first that move the markers most at the peak."""
    peak = force_N[np.linalg.norm(force_N, axis=2).sum(axis=1).argmax()]
    n = len(peak)
    moved = np.einsum("dnx,nx->dn", model.compliance.reshape(3 * n, n, 3), peak)
    return np.asarray(np.linalg.eigh(moved.T @ moved)[1][:, ::-1].T[:SCALE_MODES])


def _design_effect(
    known: Information, place_mm: Float[np.ndarray, "n 3"], chosen: list[int]
) -> float:
    """By how much the variance of the chosen amounts exceeds that of independent noise; one at least.

    What the model leaves is alike from frame to frame and from marker to neighbour. So the scores are summed
    over blocks of BLOCK_MM, each taken as one draw (Liang and Zeger 1986, Biometrika 73, cluster-robust
    variance); their mean square over what independent noise would give, averaged over the amounts.
    """
    block = np.unique(np.floor(place_mm / BLOCK_MM), axis=0, return_inverse=True)[1].reshape(-1)
    sums = np.zeros((block.max() + 1, len(chosen)))
    np.add.at(sums, block, known.scores[:, chosen])
    expected = np.diag(known.normal)[chosen]
    return max(1.0, float(np.mean((sums**2).sum(axis=0) / expected)))
