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
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.result import GraspTrace, HeldOut
from fem.parallel_map import parallel_map

NOISE_DRAWS = 8
"""Draws of the markers' noise: its residual is then known to a percent (some thousand numbers each)."""


def cross_validated(
    model: CaseModel,
    recorded: Sequence[GraspEquations],
    before: tuple[GramMatrix, Sequence[int]],
    after: tuple[GramMatrix, Sequence[int]],
) -> tuple[HeldOut | None, tuple[GraspTrace, ...]]:
    """Each recording's residual under both fits to the others; under its own fit if there is only one.

    HeldOut: root mean square residual of the markers' motion over the response, which equals the normalised
    force residual, as forces are proportional to displacements; None if there is only one recording.
    `noise_rms`: the same for the markers' noise alone, after places, scales and motions are fitted out.
    """
    count = len(recorded)

    def left(case: tuple[tuple[GramMatrix, Sequence[int]], int]) -> Float[np.ndarray, "_f _n 3"]:
        """Residual of a recording, mm."""
        (products, columns), k = case
        others = [j for j in range(count) if j != k] or [k]
        return products.marker_residual(k, products.fit(columns, keep=others))

    cases = [(fitted, k) for fitted in (before, after) for k in range(count)]
    residuals = parallel_map(left, cases, workers=model.workers)
    pairs = list(zip(residuals[:count], residuals[count:], strict=True))
    traces = tuple(_trace(model, equations, *pair) for equations, pair in zip(recorded, pairs, strict=True))
    if count < 2:
        return None, traces
    lost = np.sum([[(residual**2).sum() for residual in pair] for pair in pairs], axis=0)
    whole = sum(_size(model, equations) for equations in recorded)
    rng = np.random.default_rng(0)
    noise = sum(noise_left_mm2(equations.markers, rng) for equations in recorded)
    rms_before, rms_after, noise_rms = (float(np.sqrt(part / whole)) for part in (*lost, noise))
    return HeldOut(rms_before=rms_before, rms_after=rms_after, noise_rms=noise_rms), traces


def _trace(
    model: CaseModel,
    equations: GraspEquations,
    before: Float[np.ndarray, "f n 3"],
    after: Float[np.ndarray, "f n 3"],
) -> GraspTrace:
    """Force over approach: as recorded, and by the fits before and after."""
    recording = equations.recording
    plain = _approach(recording, model.compliance * recording.tracks.unit_displacement)
    given = plain + _approach(recording, before)
    forces = [np.linalg.norm(recording.pad_force(pad), axis=1) for pad in range(len(recording.links))]
    return GraspTrace(
        grasp=recording.case.name,
        time_s=recording.time_s,
        phase=tuple(np.array(recording.case.history.phase)[recording.used].tolist()),
        force_N=np.mean(forces, axis=0),
        given_mm=given,
        before_mm=plain,
        after_mm=given - _approach(recording, after),
    )


def _approach(recording: GraspResponse, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, " f"]:
    """Mean of a field along the pads' normals over the markers that touch."""
    normals = recording.pose[:, 0, :3, 2][recording.pad_of_marker]
    weight = recording.touching / np.maximum(recording.touching.sum(axis=1, keepdims=True), 1)
    return np.asarray(np.einsum("fnx,nx,fn->f", field, normals, weight))


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


def _size(model: CaseModel, equations: GraspEquations) -> float:
    tracks = equations.recording.tracks
    response = about_episode_mean(model.compliance * tracks.unit_displacement, tracks.episode)
    return float((response**2).sum())
