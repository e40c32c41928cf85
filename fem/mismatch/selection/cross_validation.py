"""Cross-validation: how well a model predicts recordings that its fit did not use."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fem.estimation.coloured_noise import drawn_coloured_noise
from fem.estimation.compliance_fit import about_episode_mean
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import MarkerEquations
from fem.mismatch.result import HeldOut
from fem.parallel_map import parallel_map

NOISE_DRAWS = 8
"""Draws of the markers' noise, by which what it leaves is known to a percent (some thousand numbers each)."""


def held_out(
    model: CaseModel,
    recorded: Sequence[GraspEquations],
    before: tuple[GramMatrix, Sequence[int]],
    after: tuple[GramMatrix, Sequence[int]],
) -> HeldOut | None:
    """Each recording in turn left out of both fits, and predicted; None where there is only one.

    Residual of the markers' motion over the response, root mean square: as forces are proportional to
    displacements, the normalised force residual. `noise_rms`: the same by the markers' noise alone, of which
    places, scales and motions take their part as well.
    """
    count = len(recorded)
    if count < 2:
        return None
    models = [(fitted, k) for fitted in (before, after) for k in range(count)]
    left_out = parallel_map(
        lambda model_and_grasp: _residual_squares(*model_and_grasp[0], model_and_grasp[1], count),
        models,
        workers=model.workers,
    )
    lost = [sum(left_out[:count]), sum(left_out[count:])]
    whole = sum(_size(model, equations) for equations in recorded)
    rng = np.random.default_rng(0)
    noise = sum(noise_left_mm2(equations.markers, rng) for equations in recorded)
    return HeldOut(
        rms_before=float(np.sqrt(lost[0] / whole)),
        rms_after=float(np.sqrt(lost[1] / whole)),
        noise_rms=float(np.sqrt(noise / whole)),
    )


def noise_left_mm2(markers: MarkerEquations, rng: np.random.Generator) -> float:
    """Residual sum of squares of the markers' noise alone: the mean over NOISE_DRAWS."""
    tracks = markers.tracks
    drawn = drawn_coloured_noise((NOISE_DRAWS, *tracks.position_mm.shape), float(tracks.lag1.mean()), rng)
    return float(np.mean([(markers.residual(tracks.sd_mm[:, None] * noise) ** 2).sum() for noise in drawn]))


def predictive(products: GramMatrix, columns: Sequence[int]) -> Float[np.ndarray, " g"] | None:
    """ln p(recording | all others) of each recording; None where there are no others."""
    count = len(products.rows)
    if count < 2:
        return None
    whole = products.fit(columns).log_evidence
    return np.array(
        [
            whole - products.fit(columns, keep=[j for j in range(count) if j != k]).log_evidence
            for k in range(count)
        ]
    )


def predictive_gain(
    before: Float[np.ndarray, " g"] | None, after: Float[np.ndarray, " g"] | None
) -> tuple[float, float] | None:
    """Sum over recordings of the gain in log predictive density, and its standard error: that of a sum of
    independent gains (Vehtari, Gelman and Gabry 2017, Statistics and Computing 27, equation 23).
    """
    if before is None or after is None:
        return None
    gain = after - before
    return float(gain.sum()), float(np.sqrt(len(gain)) * gain.std(ddof=1))


def _residual_squares(products: GramMatrix, columns: Sequence[int], k: int, count: int) -> float:
    """Residual sum of squares, mm2, of recording k in the fit to the others."""
    others = products.fit(columns, keep=[j for j in range(count) if j != k])
    return float((products.marker_residual(k, others) ** 2).sum())


def _size(model: CaseModel, equations: GraspEquations) -> float:
    tracks = equations.recording.tracks
    response = about_episode_mean(model.compliance * tracks.unit_displacement, tracks.episode)
    return float((response**2).sum())
