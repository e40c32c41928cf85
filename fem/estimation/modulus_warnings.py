"""Signs that a modulus should not be taken at its word, with sentences for the report."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from fem.estimation.modulus_by_frame import FrameModulus
from fem.grasp_history import GraspHistory

RESIDUAL_OVER_NOISE = 4.0
"""A linear elastic fruit with a prior pit and a scanned surface leaves 1.3 to 2.6 times the noise."""
UNBALANCE = 0.05
"""Share of the force that two pads holding one fruit may differ by: marker noise and scale make 1 % or
less."""
METHODS_APART = 0.02
"""Relative difference of the two methods; mesh, pit prior and noise make 0.3 %."""
PHASES_APART = 0.05
"""Relative difference of E between loading and unloading that is said. Set by hand, as UNBALANCE."""


class ModulusSign(StrEnum):
    """What was seen; warnings are told apart by this, never by the words of their sentences."""

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
    """Of: the two methods, the residual, the balance of the pads, loading against unloading."""
    warnings: list[ModulusWarning] = []
    if energy_MPa is None:
        said = (
            "the forces do no work on the displacement (their clocks may differ). There is no energy "
            "estimate, and the least-squares estimate is uncertain"
        )
        warnings.append(ModulusWarning(ModulusSign.NO_WORK, said))
    elif abs(np.log(energy_MPa / least_squares_MPa)) > METHODS_APART:
        said = (
            f"the energy ratio gives {energy_MPa:.3f} MPa and least squares gives "
            f"{least_squares_MPa:.3f} MPa, so this grasp contains more than linear elastic flesh"
        )
        warnings.append(ModulusWarning(ModulusSign.METHODS_APART, said))
    if noise_mm > 0 and residual_rms_mm > RESIDUAL_OVER_NOISE * noise_mm:
        said = (
            f"the linear model leaves a residual of {1e3 * residual_rms_mm:.0f} um of marker motion; "
            f"noise in displacement and force explains {1e3 * noise_mm:.0f} um"
        )
        warnings.append(ModulusWarning(ModulusSign.RESIDUAL, said))
    if fruit_moves and len(history.pads) == 2:
        total = [float(np.linalg.norm(pad.force_N.sum(axis=1), axis=1).max()) for pad in history.pads]
        if abs(total[0] - total[1]) > UNBALANCE * max(total):
            both = " and ".join(f"{pad.name} {t:.2f} N" for pad, t in zip(history.pads, total, strict=True))
            said = (
                f"the forces of the pads do not balance at their peak ({both}); check the gains of "
                "the sensors"
            )
            warnings.append(ModulusWarning(ModulusSign.UNBALANCED, said))
    return tuple(warnings + _phases_apart(frames))


def _phases_apart(frames: tuple[FrameModulus, ...]) -> list[ModulusWarning]:
    """Loading against unloading, frames of at least half the peak force."""
    both = [frame for frame in frames if frame.pad == "all" and np.isfinite(frame.E_MPa)]
    heavy = [frame for frame in both if frame.force_N > 0.5 * max(f.force_N for f in both)]
    mean = {
        phase: float(np.mean([frame.E_MPa for frame in heavy if frame.phase == phase]))
        for phase in ("load", "unload")
        if any(frame.phase == phase for frame in heavy)
    }
    if len(mean) < 2 or abs(mean["load"] / mean["unload"] - 1) <= PHASES_APART:
        return []
    said = (
        f"loading gives {mean['load']:.3f} MPa and unloading {mean['unload']:.3f} MPa. Either the "
        "flesh creeps, yields or slips, or forces and positions have different clocks"
    )
    return [ModulusWarning(ModulusSign.PHASES_APART, said)]
