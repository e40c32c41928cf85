"""Young's modulus of the flesh from one recording, two ways, each with its standard deviation."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from fem.failure import FemFailure, FemProblem
from fem.forward import UnitModulusSolid
from fem.modulus_absolute import absolute_compliance
from fem.modulus_budget import ErrorBudget
from fem.modulus_energy import energy_ratio
from fem.modulus_fit import CompliantFit, MarkerTracks, fit_compliance
from fem.modulus_force_noise import noise_tracks, without_force_noise
from fem.modulus_frames import FrameModulus, modulus_per_frame
from fem.modulus_inputs import GraspHistory
from fem.modulus_response import marker_tracks
from fem.modulus_thinning import thinned
from fem.modulus_warnings import warnings_of

NOISY = 0.1
"""A first-touch fit with more relative noise than this knows less than the absolute surface does."""
NO_WORK_SD = 0.5
"""Relative spread where force and displacement do not even do positive work on each other."""


@dataclass(frozen=True, kw_only=True)
class MethodEstimate:
    """One method's modulus.

    `own_sd_MPa`: what this recording alone brings, noise and scale errors of the sensor and misfit of the
    model (half the relative difference between the two methods, which weigh frames differently). `sd_MPa`:
    that with the model's part.
    """

    E_MPa: float
    own_sd_MPa: float
    sd_MPa: float


@dataclass(frozen=True, kw_only=True)
class ModulusEstimate:
    """Young's modulus from one recording.

    `E_MPa` is the least-squares one; `model_sd_MPa` the part of its spread that another grasp of the same
    fruit shares (mesh, surface, pit prior). `energy` is None where the measured work is not positive.
    `form`: "first-touch" (each marker against itself) or "absolute" (the frame of the greatest force against
    the scanned surface), where only one frame is loaded or where noise leaves the first-touch fit a spread of
    more than NOISY; a warning says which. `loaded` marks the frames used, `residual_mm` is what the model
    leaves of each marker's place in them (NaN out of contact).
    """

    E_MPa: float
    E_sd_MPa: float
    model_sd_MPa: float
    least_squares: MethodEstimate
    energy: MethodEstimate | None
    form: Literal["first-touch", "absolute"]
    residual_rms_mm: float
    frames: tuple[FrameModulus, ...]
    warnings: tuple[str, ...]
    loaded: Bool[np.ndarray, " t"] = field(repr=False)
    residual_mm: Float[np.ndarray, "f n 3"] = field(repr=False)


def estimate_modulus(
    history: GraspHistory, solid: UnitModulusSolid, *, budget: ErrorBudget
) -> ModulusEstimate:
    """The modulus that makes the fruit of `solid` move under the measured forces as the markers moved.

    Least squares over all frames and markers (modulus_fit) and the strain-energy ratio (modulus_energy), each
    marker compared with its own first touch; against the scanned surface (modulus_absolute) where only one
    frame is loaded, or where noise makes the first-touch compliance uncertain by more than NOISY. One solve
    per frame used: the loaded frames, thinned evenly where there are more than MOST_FRAMES of them
    (modulus_thinning). Raises FemFailure: no-load, no-modulus (forces and displacement contradict any elastic
    fruit), off-surface.
    """
    loaded = np.any([(pad.episode >= 0).any(axis=1) for pad in history.pads], axis=0)
    if not loaded.any():
        raise FemFailure(FemProblem.NO_LOAD, "found no frame in which a marker touches, expected a contact")
    loaded = thinned(loaded)
    tracks, force = marker_tracks(history, solid, loaded)
    moves = solid.support == "free"
    reason = "only one frame is loaded"
    advice = "record the frames before and during the closing of the jaws"
    if loaded.sum() > 1:
        fit = fit_compliance(tracks, scale_sd=budget.gel_scale_sd, fruit_moves=moves)
        air = noise_tracks(history, solid, tracks, loaded)
        fit, force_noise_mm = without_force_noise(
            fit, tracks, air[0] if air else None, scale_sd=budget.gel_scale_sd, fruit_moves=moves
        )
        if fit.compliance_sd < NOISY * abs(fit.compliance):
            return _from_first_touch(
                history,
                tracks,
                force,
                fit,
                loaded,
                budget=budget,
                fruit_moves=moves,
                force_noise_mm=force_noise_mm,
                quiet=air,
            )
        reason = (
            f"noise leaves the comparison of {loaded.sum()} loaded frames with each marker's first touch a "
            f"spread of more than {NOISY:.0%}"
        )
        advice = "press deeper or lower the sensor's noise"
    warning = (
        f"{reason}: the modulus rests on one frame and the scanned surface, and its error is large; {advice}"
    )
    return _absolute(history, tracks, force, loaded, warning, budget=budget, fruit_moves=moves)


def _from_first_touch(
    history: GraspHistory,
    tracks: MarkerTracks,
    force: Float[np.ndarray, "f n 3"],
    fit: CompliantFit,
    loaded: Bool[np.ndarray, " t"],
    *,
    budget: ErrorBudget,
    fruit_moves: bool,
    force_noise_mm: float,
    quiet: tuple[MarkerTracks, Float[np.ndarray, "f n 3"]] | None,
) -> ModulusEstimate:
    ratio = energy_ratio(
        tracks,
        force,
        fit.motion_mm,
        force_sd_N=max(pad.force_sd_N for pad in history.pads),
        gel_scale_sd=budget.gel_scale_sd,
        force_scale_sd=budget.force_scale_sd,
        quiet=quiet,
    )
    modulus = _require_positive(fit.compliance)
    by_force = (ratio.force_noise, ratio.force_scale)
    elastic = ratio.work_Nmm > 0 and ratio.modulus_MPa > 0
    misfit = 0.5 * abs(float(np.log(ratio.modulus_MPa / modulus))) if elastic else NO_WORK_SD
    noise_mm = float(np.hypot(tracks.sd_mm.mean(), force_noise_mm))
    excess = max(1.0, fit.residual_rms_mm / noise_mm)
    least_squares = _method(modulus, (excess * fit.compliance_sd * modulus, misfit, *by_force), budget)
    by_energy = (ratio.displacement_noise, ratio.gel_scale, misfit, *by_force)
    energy = _method(ratio.modulus_MPa, by_energy, budget) if elastic else None
    frames = modulus_per_frame(history, tracks, fit, loaded)
    return ModulusEstimate(
        E_MPa=modulus,
        E_sd_MPa=least_squares.sd_MPa,
        model_sd_MPa=budget.model_sd * modulus,
        least_squares=least_squares,
        energy=energy,
        form="first-touch",
        residual_rms_mm=fit.residual_rms_mm,
        frames=frames,
        warnings=warnings_of(
            history,
            frames,
            least_squares_MPa=modulus,
            energy_MPa=energy.E_MPa if energy else None,
            residual_rms_mm=fit.residual_rms_mm,
            noise_mm=noise_mm,
            fruit_moves=fruit_moves,
        ),
        loaded=loaded,
        residual_mm=fit.residual_mm,
    )


def _absolute(
    history: GraspHistory,
    tracks: MarkerTracks,
    force: Float[np.ndarray, "f n 3"],
    loaded: Bool[np.ndarray, " t"],
    warning: str,
    *,
    budget: ErrorBudget,
    fruit_moves: bool,
) -> ModulusEstimate:
    """From the frame of the greatest force alone; `warning` says why."""
    peak = int(np.argmax(np.linalg.norm(force, axis=2).sum(axis=1)))
    pads = np.repeat(np.arange(len(history.pads)), [len(pad.rest_mm) for pad in history.pads])
    fit = absolute_compliance(
        tracks, force, peak, pad_of_marker=pads, surface_sd_mm=budget.surface_sd_mm, fruit_moves=fruit_moves
    )
    modulus = _require_positive(fit.compliance)
    spread = (fit.noise, fit.surface)
    least_squares = _method(modulus, spread, budget)
    energy = _method(1 / fit.energy_compliance, spread, budget) if fit.energy_compliance > 0 else None
    only = np.zeros_like(loaded)
    only[np.flatnonzero(loaded)[peak]] = True
    return ModulusEstimate(
        E_MPa=modulus,
        E_sd_MPa=least_squares.sd_MPa,
        model_sd_MPa=float(np.hypot(budget.model_sd, fit.surface)) * modulus,
        least_squares=least_squares,
        energy=energy,
        form="absolute",
        residual_rms_mm=float(np.sqrt(np.nanmean((fit.residual_mm**2).sum(axis=2)))),
        frames=(),
        warnings=(warning,),
        loaded=only,
        residual_mm=fit.residual_mm,
    )


def _method(modulus: float, relative: tuple[float, ...], budget: ErrorBudget) -> MethodEstimate:
    noise = float(np.sqrt(np.sum(np.square(relative))))
    total = float(np.hypot(noise, budget.model_sd))
    return MethodEstimate(E_MPa=modulus, own_sd_MPa=noise * modulus, sd_MPa=total * modulus)


def _require_positive(compliance: float) -> float:
    """E in MPa, where the compliance allows one."""
    if not (np.isfinite(compliance) and compliance > 0):
        raise FemFailure(
            FemProblem.NO_MODULUS,
            f"found a compliance of {compliance:.3g} per MPa, expected one above zero: the markers do "
            "not give way to "
            "the forces; check the signs of force and pose, and that both are of the same moment",
        )
    return 1 / compliance
