"""Information of one recording on the modulus, and on all other causes that move the same markers.

Each pad's markers are compared with the model's response as a whole: one number per pad, the pad's own 1/E,
from the fit of fem.estimation.compliance_fit with one column per pad. Every cause p of
fem.estimation.sensitivity, and every scale error h of the markers' forces, changes these numbers by the same
fit to its field dC/dp f, or C diag(f) h. The finer pattern within a patch is not used: a pit changes it by a
few tenths of a micrometre, less than the error of any model there.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import JudgedInformation, MarkerTracks, information, judged_information
from fem.estimation.grasp_model import GraspModel
from fem.estimation.sensitivity import leading_patterns
from fem.estimation.unit_response import per_marker
from fem.grasp_history import GraspHistory

SCALE_MODES = 16
"""Patterns of force-scale errors that are kept: those that move the markers most."""
FORCE_SCALE = "force scale"
SEEN = 1e-9
"""A pad with less than this share of the best pad's information is left out."""
BETWEEN_PADS = 3.7
"""Variance of the difference between the pads of a recording over that from noise, with pit and places at
their priors. Fitted by maximum likelihood to 54 recordings of fruit without mismatch (the even half of the
bank of benchmarks/field_bank.py). Causes: the error of the gel's stiffness from which forces are computed,
the choice of pressing markers, and contact that no model describes. We assume that these do not change the
pads' common value: E of fruit without mismatch is no further off than stated (docs/validation.md, Accuracy
of E)."""
BLOCK_MM = 4.0
"""Size of the blocks of skin within which the model's residuals count as one draw."""


@dataclass(frozen=True, kw_only=True)
class GraspInformation:
    """Normal equations N a = b of the amounts a = s (1, p_1, ..., h_1, ...), s = 1/E, per MPa.

    `causes` names all but the first: those of the sensitivity, then FORCE_SCALE once for each pattern. The
    rank of N is the number of pads.
    """

    causes: tuple[str, ...]
    normal: Float[np.ndarray, "k k"]
    right: Float[np.ndarray, " k"]

    def weakened(self, factor: float) -> "GraspInformation":
        """The same information with a variance `factor` times as great."""
        return replace(self, normal=self.normal / factor, right=self.right / factor)


def grasp_information(
    tracks: MarkerTracks,
    model: GraspModel,
    force_N: Float[np.ndarray, "t n 3"],
    *,
    history: GraspHistory,
    scale_sd: float,
) -> GraspInformation:
    """The information of one recording: that of 1/E of each pad that has some.

    The noise of positions is scaled to the model's residual. Noise in the forces (`_of_force_noise`) adds to
    the variance of the pads' 1/E. The variance of their differences is BETWEEN_PADS times that from noise.
    """
    pad_of_marker = history.pad_of_marker
    felt = tracks.unit_displacement
    pads = [np.where((pad_of_marker == pad)[:, None], felt, 0.0) for pad in np.unique(pad_of_marker)]
    patterns = _scale_patterns(model, force_N)
    scaled = _moved_by_scales(model, force_N, patterns)
    moves = model.fruit_moves
    # The residual is that of the pads' own fit alone: free causes would explain it away.
    alone = judged_information(tracks, np.stack(pads), scale_sd=scale_sd, fruit_moves=moves)
    recording = np.diag(alone.normal) > SEEN * np.diag(alone.normal).max()
    if not recording.all():  # a pad whose markers touch in one frame only has no information
        pads = [pad for pad, says in zip(pads, recording, strict=True) if says]
        alone = judged_information(tracks, np.stack(pads), scale_sd=scale_sd, fruit_moves=moves)
    pad_fields = np.arange(len(pads))
    normal = alone.normal
    each = np.linalg.solve(normal, alone.right)
    fields = np.stack([*pads, *model.sensitivity.values, *scaled])
    known = information(tracks, fields, scale_sd=scale_sd, fruit_moves=moves)
    # The pads' own fit to each field; the pads' fields add up to the response itself.
    sees = np.linalg.solve(normal, known.normal[pad_fields])
    variance = _design_effect(alone, model.place_mm) * normal
    variance += _of_force_noise(alone, model, tracks, history, compliance=float(each.mean()))
    weight = _between_pads(normal @ np.linalg.solve(variance, normal))
    slopes = np.column_stack([np.ones(len(each)), sees[:, len(pads) :]])
    return GraspInformation(
        causes=(*model.sensitivity.causes, *len(patterns) * (FORCE_SCALE,)),
        normal=slopes.T @ weight @ slopes,
        right=slopes.T @ weight @ each,
    )


def _between_pads(weight: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Weights of the pads' numbers with BETWEEN_PADS times the variance of their differences. V, the inverse
    of `weight` W, is the variance 1 1' / (1' W 1) of their common value plus that of the differences.
    """
    common = np.outer(weight.sum(axis=1), weight.sum(axis=0)) / weight.sum()
    return np.asarray(weight / BETWEEN_PADS + (1 - 1 / BETWEEN_PADS) * common)


def _of_force_noise(
    alone: JudgedInformation,
    model: GraspModel,
    tracks: MarkerTracks,
    history: GraspHistory,
    *,
    compliance: float,
) -> Float[np.ndarray, "p p"]:
    """Contribution of noise n in the forces to the covariance of the pads' right-hand sides, by a false
    displacement s C n.

    Unlike noise in displacement, noise in one force moves the markers of both pads. Its share in 1/E does not
    fall with the number of markers as that of displacement does: the noise of the total force remains. If
    forces are computed from the gel's displacement, n is the noise of positions too, and both are counted
    once. The gel's stiffness and the set of pressing markers are taken as known.
    """
    pads, frames = alone.influence.shape[:2]
    inflation = variance_inflation(tracks.lag1)
    force_sd_N = per_marker(history, lambda pad: pad.force_sd_N)
    noise = history.pattern_noise
    if noise is None:
        felt = compliance * (alone.influence.reshape(pads * frames, -1) @ model.compliance)
        felt = felt.reshape(alone.influence.shape)
        return _covariance(felt, inflation * force_sd_N**2)
    response = compliance * model.unit_displacement(noise.patterns)
    amounts = np.einsum("ptnx,rnx->ptr", alone.influence, response, optimize=True)
    of_force = np.tensordot(amounts, noise.of_force, axes=1)
    of_places = alone.influence - np.tensordot(amounts, noise.of_displacement, axes=1)
    places_mm2 = inflation * tracks.sd_mm**2
    return np.asarray(
        _covariance(of_force, inflation * force_sd_N**2)
        + _covariance(of_places, places_mm2)
        - _covariance(alone.influence, places_mm2)
    )


def feigned_displacement_sd(model: GraspModel, history: GraspHistory) -> float:
    """False displacement times E, mm MPa, from noise in the forces of one frame: root mean square over the
    markers' components.
    """
    force_sd_N = per_marker(history, lambda pad: pad.force_sd_N)
    noise = history.pattern_noise
    if noise is None:
        feigned = model.compliance * np.repeat(force_sd_N, 3)
    else:
        places_mm = per_marker(history, lambda pad: pad.displacement_sd_mm)
        amounts = np.concatenate(
            [noise.of_displacement * places_mm[:, None], noise.of_force * force_sd_N[:, None]], axis=1
        )
        response = model.unit_displacement(noise.patterns).reshape(len(noise.patterns), -1)
        feigned = response.T @ amounts.reshape(len(amounts), -1)
    return float(np.sqrt((feigned**2).sum(axis=1).mean()))


def _covariance(
    influence: Float[np.ndarray, "p t n 3"], variance: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "p p"]:
    """Of numbers with this `influence` of the markers' independent noise, of this `variance`."""
    return np.asarray(np.einsum("ptnx,qtnx,n->pq", influence, influence, variance, optimize=True))


def _scale_patterns(model: GraspModel, force_N: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "k n"]:
    """Orthonormal patterns of marker scales; the first ones move the markers most at the peak."""
    peak = force_N[np.linalg.norm(force_N, axis=2).sum(axis=1).argmax()]
    n = len(peak)
    moved = np.einsum("dnx,nx->dn", model.compliance.reshape(3 * n, n, 3), peak)
    first = max(0, n - SCALE_MODES)
    return np.asarray(eigh(moved.T @ moved, subset_by_index=[first, n - 1])[1][:, ::-1].T)


def _moved_by_scales(
    model: GraspModel, force_N: Float[np.ndarray, "t n 3"], patterns: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "k t n 3"]:
    """C diag(f) h for each pattern h, frame by frame, from the leading patterns of the forces."""
    modes, share = leading_patterns(force_N)
    scaled = (patterns[:, None, :, None] * modes).reshape(-1, *modes.shape[1:])
    moved = model.unit_displacement(scaled).reshape(len(patterns), *modes.shape)
    return np.asarray(np.tensordot(share, moved, axes=(1, 1)).swapaxes(0, 1))


def _design_effect(alone: JudgedInformation, place_mm: Float[np.ndarray, "n 3"]) -> float:
    """The variance of the pads' numbers over that from independent noise; at least one.

    Residuals of the model correlate between frames and between neighbouring markers. So the scores are summed
    over blocks of BLOCK_MM, each taken as one draw (Liang and Zeger 1986, Biometrika 73, cluster-robust
    variance). The result is their sum of squares over that of independent noise, averaged over the pads.
    """
    block = np.unique(np.floor(place_mm / BLOCK_MM), axis=0, return_inverse=True)[1].reshape(-1)
    sums = np.zeros((block.max() + 1, alone.scores.shape[1]))
    np.add.at(sums, block, alone.scores)
    return max(1.0, float(np.mean((sums**2).sum(axis=0) / np.diag(alone.normal))))
