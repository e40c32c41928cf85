"""Faults of the gels themselves, alike in all pads: each states how the recorded numbers follow from the true
ones, and `without_gel_fault` inverts it. A bare indenter has no gel, and stays as it is.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from tactile.io.recording import GelPad, Recording

LEAST_SLOPE = 0.1
"""Of the reading over the force: where noise lifts a reading beyond the largest that the law has, its root is
taken as that of this slope."""
NONE = 1e-9
"""An amount that is none."""
LEAST_PEAK, NO_FORCE_N = 0.02, 1e-12
"""Share of the whole press's peak below which there is no peak so far but noise, and a force that is none."""
TURNS = 12
"""Newton's turns for a pad's true force over its peak, of a cubic that rises for shares up to 3/4."""
AIR = 0.02
"""Share of the greatest total force up to which a pad is in the air before its contact."""


@dataclass(frozen=True, kw_only=True)
class ForceLawFault:
    """Recorded force of each marker = true force (1 + a |f| / M), M the largest |f| in the recording."""

    a: float


@dataclass(frozen=True, kw_only=True)
class GelCreepFault:
    """Recorded displacement = true one + `creep` m,  m' = (d - m) / `tau_s`, held from frame to frame at its
    new value.
    """

    creep: float
    tau_s: float


@dataclass(frozen=True, kw_only=True)
class GelHysteresisFault:
    """Recorded force = true one (1 - 4 share r (1 - r)), r the pad's force over its largest so far."""

    share: float


@dataclass(frozen=True, kw_only=True)
class ThermalFault:
    """Markers move outwards by this strain, and each pad's normal force grows by this many newtons, times the
    square root of the time since the first frame, counted from the frames in the air.
    """

    strain_per_root_s: float
    N_per_root_s: float


GelFault: TypeAlias = ForceLawFault | GelCreepFault | GelHysteresisFault | ThermalFault


def without_gel_fault(recording: Recording, fault: GelFault) -> Recording:
    """`recording` as it would be without the fault."""
    gels = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    largest = max((float(np.linalg.norm(pad.force_N, axis=2).max()) for pad in gels), default=0.0)
    pads = tuple(
        _pad(pad, fault, recording.time_s, largest) if isinstance(pad, GelPad) else pad
        for pad in recording.pads
    )
    return replace(recording, pads=pads)


def _pad(pad: GelPad, fault: GelFault, time_s: Float[np.ndarray, " t"], largest_N: float) -> GelPad:
    if isinstance(fault, ForceLawFault):
        return replace(pad, force_N=straightened(pad.force_N, a=fault.a, largest_N=largest_N))
    if isinstance(fault, GelCreepFault):
        moved = uncrept(pad.displacement_mm, time_s, creep=fault.creep, tau_s=fault.tau_s)
        return replace(pad, displacement_mm=moved)
    if isinstance(fault, GelHysteresisFault):
        return replace(pad, force_N=closed(pad.force_N, share=fault.share))
    root = np.sqrt(time_s - time_s[0])
    total = pad.force_N[:, :, 2].sum(axis=1)
    air = np.flatnonzero(total > AIR * total.max())[:1]
    root = (root - root[: max(int(air[0]) if len(air) else len(root), 1)].mean())[:, None, None]
    force = pad.force_N - fault.N_per_root_s / len(pad.rest_mm) * root * np.array([0.0, 0.0, 1.0])
    swollen = fault.strain_per_root_s * root * (pad.rest_mm * np.array([1.0, 1.0, 0.0]))
    return replace(pad, force_N=force, displacement_mm=pad.displacement_mm - swollen)


def straightened(force_N: Float[np.ndarray, "t n 3"], *, a: float, largest_N: float) -> np.ndarray:
    """True forces of recorded ones of which `largest_N` is the largest: the law's positive root.

    A reading of 1.25 N, a quarter too much, was 1 N.

    >>> straightened(np.array([[[0.0, 0, 1.25]]]), a=0.25, largest_N=1.25)[0, 0]
    array([0., 0., 1.])
    """
    if abs(a) < NONE or largest_N <= 0:
        return force_N
    size = np.linalg.norm(force_N, axis=2, keepdims=True)
    root = np.sqrt(np.maximum(1 + 4 * a * (1 + a) * size / largest_N, LEAST_SLOPE**2))
    return np.asarray(force_N * 2 / (1 + root))


def uncrept(
    displacement_mm: Float[np.ndarray, "t n 3"],
    time_s: Float[np.ndarray, " t"],
    *,
    creep: float,
    tau_s: float,
) -> Float[np.ndarray, "t n 3"]:
    """Displacement less what has crept, frame by frame; nothing has in the first."""
    moved = np.array(displacement_mm, dtype=float)
    memory = np.zeros_like(moved[0])
    for k in range(1, len(time_s)):
        fade = float(np.exp(-(time_s[k] - time_s[k - 1]) / tau_s))
        moved[k] = (moved[k] - creep * fade * memory) / (1 + creep * (1 - fade))
        memory = fade * memory + (1 - fade) * moved[k]
    return moved


def closed(force_N: Float[np.ndarray, "t n 3"], *, share: float) -> Float[np.ndarray, "t n 3"]:
    """One pad's forces with the loop closed."""
    total = force_N[:, :, 2].sum(axis=1)
    least = max(LEAST_PEAK * float(total.max()), NO_FORCE_N)
    seen = np.clip(total / np.maximum.accumulate(np.maximum(total, least)), 0.0, 1.0)
    r = seen
    for _ in range(TURNS):
        off = r * (1 - 4 * share * r * (1 - r)) - seen
        r = np.clip(r - off / (1 - 8 * share * r + 12 * share * r**2), 0.0, 1.0)
    return np.asarray(force_N / (1 - 4 * share * r * (1 - r))[:, None, None])
