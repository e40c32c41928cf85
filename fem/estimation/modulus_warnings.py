"""Signs that a modulus may be wrong, with sentences for the report."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from fem.estimation.modulus_by_frame import FrameModulus
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
