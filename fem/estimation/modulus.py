"""Young's modulus of the flesh from one recording by two methods, each with its standard deviation."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.compliance_fit import CompliantFit, MarkerTracks, fit_compliance
from fem.estimation.energy_ratio import EnergyRatio, energy_ratio
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.frame_thinning import loaded_frames
from fem.estimation.grasp_model import GraspModel
from fem.estimation.information import feigned_displacement_sd, grasp_information
from fem.estimation.joint_inference import GraspEvidence, joint_modulus
from fem.estimation.modulus_by_frame import FrameModulus, modulus_per_frame
from fem.estimation.unit_response import marker_tracks
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory

RESIDUAL_OVER_NOISE = 4.0
"""Ratio that gives a warning; linear elastic fruit with a prior pit and a scanned surface have 1.3 to 2.6."""
UNBALANCE = 0.05
"""Share of the force that two pads holding one fruit may differ by: marker noise and scale make 1 % or
less."""
METHODS_APART = 0.02
"""Relative difference of the two methods; mesh, pit prior and noise make 0.3 %."""
PHASES_APART = 0.05
"""Relative difference of E between loading and unloading that gives a warning. Set by hand, as UNBALANCE."""


class ModulusSign(StrEnum):
    """The kind of a warning; code compares kinds, never the words of their sentences."""

    NO_WORK = "no-work"
    METHODS_APART = "methods-apart"
    RESIDUAL = "residual"
    UNBALANCED = "unbalanced"
    PHASES_APART = "phases-apart"


@dataclass(frozen=True)
class ModulusWarning:
    """One sign, and its sentence without a full stop."""

    sign: ModulusSign
    sentence: str


def warnings_of(
    history: GraspHistory,
    frames: tuple[FrameModulus, ...],
    *,
    least_squares_MPa: float,
    energy_MPa: float | None,
    residual_rms_mm: float,
    noise_mm: float,
    fruit_moves: bool,
) -> tuple[ModulusWarning, ...]:
    """Warnings about the two methods, the residual, the balance of the pads, loading and unloading."""
    warnings: dict[ModulusSign, str] = {}
    if energy_MPa is None:
        warnings[ModulusSign.NO_WORK] = (
            "the forces do no work on the displacement (their clocks may differ). There is no energy "
            "estimate, and the least-squares estimate is uncertain"
        )
    elif abs(np.log(energy_MPa / least_squares_MPa)) > METHODS_APART:
        warnings[ModulusSign.METHODS_APART] = (
            f"the energy ratio gives {energy_MPa:.3f} MPa and least squares gives "
            f"{least_squares_MPa:.3f} MPa, so this grasp contains more than linear elastic flesh"
        )
    if noise_mm > 0 and residual_rms_mm > RESIDUAL_OVER_NOISE * noise_mm:
        warnings[ModulusSign.RESIDUAL] = (
            f"the linear model leaves a residual of {1e3 * residual_rms_mm:.0f} um of marker motion; "
            f"noise in displacement and force explains {1e3 * noise_mm:.0f} um"
        )
    if fruit_moves and len(history.pads) == 2:
        total = [float(np.linalg.norm(pad.force_N.sum(axis=1), axis=1).max()) for pad in history.pads]
        if abs(total[0] - total[1]) > UNBALANCE * max(total):
            both = " and ".join(f"{pad.name} {t:.2f} N" for pad, t in zip(history.pads, total, strict=True))
            warnings[ModulusSign.UNBALANCED] = (
                f"the forces of the pads do not balance at their peak ({both}); check the gains of "
                "the sensors"
            )
    load_MPa, unload_MPa = (_mean_of_phase(frames, phase) for phase in ("load", "unload"))
    if abs(load_MPa / unload_MPa - 1) > PHASES_APART:
        warnings[ModulusSign.PHASES_APART] = (
            f"loading gives {load_MPa:.3f} MPa and unloading {unload_MPa:.3f} MPa. Either the "
            "flesh creeps, yields or slips, or forces and positions have different clocks"
        )
    return tuple(ModulusWarning(sign, sentence) for sign, sentence in warnings.items())


def _mean_of_phase(frames: tuple[FrameModulus, ...], phase: str) -> float:
    """Mean E over frames of at least half the peak force, MPa; NaN where the phase has none."""
    both = [frame for frame in frames if frame.pad == "all" and np.isfinite(frame.E_MPa)]
    peak_N = max((frame.force_N for frame in both), default=0.0)
    heavy = [frame.E_MPa for frame in both if frame.force_N > 0.5 * peak_N and frame.phase == phase]
    return float(np.mean(heavy)) if heavy else float("nan")


NO_WORK_SD = 0.5
"""Relative standard deviation of E if the forces do no positive work on the displacement."""
LEAST_MISFIT = 0.004
"""Relative scatter between grasps of one synthetic fruit with small errors of mesh and pit."""
LEAST_SD, ELEMENTS_SD = 0.001, 0.5
"""Relative standard deviation of E by discretisation: least value, and factor on the mesh's missing energy.

Discretisation changes least squares over displacement less than the energy. On a recorded grasp of an
independently simulated nectarine E was 0.9996, 1.0006, 1.0014 and 1.0018 of truth at 36, 56, 124 and 194
thousand dofs, towards 1.0022, where the estimated shares were 0.51, 0.32, 0.13 and 0.07 %: half of the share.
E is not corrected for it: with elements finer than the markers, the share includes peaks at single markers.
"""
FEWEST_MARKERS = 6
"""Fewer markers under load than this do not determine the fruit's six rigid motions."""


@dataclass(frozen=True, kw_only=True)
class MethodEstimate:
    """One method's modulus and its standard deviation."""

    E_MPa: float
    sd_MPa: float


@dataclass(frozen=True, kw_only=True)
class ModulusEstimate:
    """Young's modulus from one recording.

    `E_MPa` is the least-squares one; `parts_sd_MPa` names the parts of its standard deviation (their squares
    add up), with the pit at its prior. `energy` is None if the measured work is not positive.
    `discretisation`: the share of the energy that the mesh misses. `loaded` marks the frames used,
    `residual_mm` is the residual of each marker's position in them (NaN out of contact). `evidence` is this
    recording's input to the joint inference of several grasps (fem.estimation.joint_inference).
    """

    E_MPa: float
    E_sd_MPa: float
    parts_sd_MPa: dict[str, float]
    energy: MethodEstimate | None
    discretisation: float
    residual_rms_mm: float
    frames: tuple[FrameModulus, ...]
    warnings: tuple[ModulusWarning, ...]
    evidence: GraspEvidence = field(repr=False)
    loaded: Bool[np.ndarray, " t"] = field(repr=False)
    residual_mm: Float[np.ndarray, "f n 3"] = field(repr=False)


def estimate_modulus(history: GraspHistory, model: GraspModel, *, budget: ErrorBudget) -> ModulusEstimate:
    """The modulus that makes the fruit of `model` move under the measured forces as the markers moved.

    `model` is that of the same recording (fem.estimation.grasp_model), which was prepared
    (fem.estimation.prepared_grasp): noise in its forces would lower 1/E. Least squares over all frames and
    markers (compliance_fit) and the strain-energy ratio (energy_ratio), each marker compared with its own
    first touch. The loaded frames are thinned evenly where there are more than MOST_FRAMES of them
    (frame_thinning). Raises FemFailure: no-load, too-few-markers, no-modulus (forces and displacement
    contradict any elastic fruit).
    """
    loaded = loaded_frames(history)
    tracks, force = marker_tracks(history, model, loaded)
    require_markers(tracks)
    fit = fit_compliance(tracks, scale_sd=budget.gel_scale_sd, fruit_moves=model.fruit_moves)
    evidence, ratio = first_touch_evidence(tracks, force, fit, history=history, model=model, budget=budget)
    modulus = evidence.E_MPa
    alone = joint_modulus([evidence], budget=budget, infer_pit=False)
    share = {part: sd / alone.E_MPa for part, sd in alone.parts_sd_MPa.items()}
    noise = float(np.linalg.norm([*share.values(), ratio.displacement_noise, ratio.gel_scale]))
    energy = None
    if ratio.elastic:
        energy = MethodEstimate(E_MPa=ratio.modulus_MPa, sd_MPa=noise * ratio.modulus_MPa)
    frames = modulus_per_frame(history, tracks, fit, loaded)
    feigned_mm = fit.compliance * feigned_displacement_sd(model, history)
    return ModulusEstimate(
        E_MPa=modulus,
        E_sd_MPa=modulus * float(np.linalg.norm(list(share.values()))),
        parts_sd_MPa={part: sd * modulus for part, sd in share.items()},
        energy=energy,
        discretisation=model.discretisation,
        residual_rms_mm=fit.residual_rms_mm,
        frames=frames,
        warnings=warnings_of(
            history,
            frames,
            least_squares_MPa=modulus,
            energy_MPa=energy.E_MPa if energy else None,
            residual_rms_mm=fit.residual_rms_mm,
            noise_mm=float(np.hypot(tracks.sd_mm.mean(), feigned_mm)),
            fruit_moves=model.fruit_moves,
        ),
        evidence=evidence,
        loaded=loaded,
        residual_mm=fit.residual_mm,
    )


def first_touch_evidence(
    tracks: MarkerTracks,
    force_N: Float[np.ndarray, "f n 3"],
    fit: CompliantFit,
    *,
    history: GraspHistory,
    model: GraspModel,
    budget: ErrorBudget,
) -> tuple[GraspEvidence, EnergyRatio]:
    """A recording's input to the inference, and its energy ratio.

    `tracks` may have another response to the forces than that of `model`; `fit` is their fit. Raises
    FemFailure (no-modulus) if 1/E is not above zero.
    """
    ratio = energy_ratio(tracks, force_N, fit.motion_mm, gel_scale_sd=budget.gel_scale_sd)
    E_MPa = require_positive(fit.compliance)
    apart = 0.5 * abs(float(np.log(ratio.modulus_MPa / E_MPa))) if ratio.elastic else NO_WORK_SD
    evidence = GraspEvidence(
        information=grasp_information(tracks, model, force_N, history=history, scale_sd=budget.gel_scale_sd),
        E_MPa=E_MPa,
        misfit_sd=float(np.hypot(LEAST_MISFIT, apart)),
        discretisation_sd=LEAST_SD + ELEMENTS_SD * model.discretisation,
        history=history,
    )
    return evidence, ratio


def require_markers(tracks: MarkerTracks) -> None:
    """Raises FemFailure (too-few-markers) unless FEWEST_MARKERS are in two frames or more of one contact."""
    touched = int((tracks.episode >= 0).any(axis=0).sum())
    if touched < FEWEST_MARKERS:
        raise FemFailure(
            FemProblem.TOO_FEW_MARKERS,
            f"found {touched} markers under load, expected at least {FEWEST_MARKERS}. Press deeper, "
            "or check for a pad that touches only with its edge",
        )
    contacts = range(int(tracks.episode.max()) + 1)
    twice = [(tracks.episode == contact).sum(axis=0) > 1 for contact in contacts]
    compared = int(np.any(twice, axis=0).sum())
    if compared < FEWEST_MARKERS:
        raise FemFailure(
            FemProblem.TOO_FEW_MARKERS,
            f"found {compared} markers that stay in contact for two frames, expected at least "
            f"{FEWEST_MARKERS}. Record the frames before and during the closing of the jaws",
        )


def require_positive(compliance: float) -> float:
    """E in MPa; raises NO_MODULUS if there is none."""
    if not (np.isfinite(compliance) and compliance > 0):
        raise FemFailure(
            FemProblem.NO_MODULUS,
            f"found a compliance of {compliance:.3g} per MPa, expected a positive value. Check the "
            "signs of forces and poses, and that both share one clock",
        )
    return 1 / compliance
