"""A recording with known faults of pads, jaws and gels removed.

Each fault states how the recorded numbers follow from the true ones; `corrected` inverts it. Gel faults are
the same in all pads; a bare indenter has no gel, and stays unchanged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from tactile.markers.gaps import at_times, poses_at
from tactile.readers.recording import GelPad, IndenterPad, Recording
from tactile.rig.rig_curve import MOST_BEYOND, RigCurve
from tactile.tactile_failure import TactileProblem

LEAST_SLOPE = 0.1
"""Least slope of the reading over the force. It replaces the law's slope if noise lifts a reading beyond the
law's maximum."""
NONE = 1e-9
"""An amount that counts as 0."""
LEAST_PEAK, NO_FORCE_N = 0.02, 1e-12
"""Share of the whole press's peak below which the peak so far is noise, and a force that counts as 0."""
TURNS = 12
"""Newton iterations for a pad's true force over its peak, of a cubic that rises for shares up to 3/4."""
AIR = 0.02
"""Share of the greatest total force up to which a pad has no contact yet."""


@dataclass(frozen=True, kw_only=True)
class ForceLawFault:
    """Recorded force of each marker = true force (1 + a |f| / M), M the largest |f| in the recording."""

    a: float


@dataclass(frozen=True, kw_only=True)
class GelCreepFault:
    """Recorded displacement = true one d + `creep` m,  m' = (d - m) / `tau_s`, with d constant at its new
    value from frame to frame.
    """

    creep: float
    tau_s: float


@dataclass(frozen=True, kw_only=True)
class GelHysteresisFault:
    """Recorded force = true one (1 - 4 share r (1 - r)), r the pad's force over its largest so far."""

    share: float


@dataclass(frozen=True, kw_only=True)
class ThermalFault:
    """Markers move outwards by this strain, and each pad's normal force grows by this many newtons. Both are
    times the square root of the time since the first frame, relative to the no-contact frames.
    """

    strain_per_root_s: float
    N_per_root_s: float


GelFault: TypeAlias = ForceLawFault | GelCreepFault | GelHysteresisFault | ThermalFault


def _gel_pad(pad: GelPad, fault: GelFault, time_s: Float[np.ndarray, " t"], largest_N: float) -> GelPad:
    if isinstance(fault, ForceLawFault):
        return replace(pad, force_N=straightened(pad.force_N, fault.a, largest_N=largest_N))
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


def straightened(
    force_N: Float[np.ndarray, "t n 3"], a: float, *, largest_N: float | None = None
) -> Float[np.ndarray, "t n 3"]:
    """True forces from recorded forces, by the positive root of the law; `largest_N`: largest recorded force,
    None if `force_N` holds all.

    A reading of 1.25 N, a quarter too much, was 1 N.

    >>> straightened(np.array([[[0.0, 0, 1.25]]]), 0.25)[0, 0]
    array([0., 0., 1.])
    """
    size = np.linalg.norm(force_N, axis=2, keepdims=True)
    largest_N = float(size.max(initial=0.0)) if largest_N is None else largest_N
    if abs(a) < NONE or largest_N <= 0:
        return force_N
    root = np.sqrt(np.maximum(1 + 4 * a * (1 + a) * size / largest_N, LEAST_SLOPE**2))
    return np.asarray(force_N * 2 / (1 + root))


def uncrept(
    displacement_mm: Float[np.ndarray, "t n 3"],
    time_s: Float[np.ndarray, " t"],
    *,
    creep: float,
    tau_s: float,
) -> Float[np.ndarray, "t n 3"]:
    """Displacement minus its creep, frame by frame; the first frame has none."""
    moved = np.array(displacement_mm, dtype=float)
    memory = np.zeros_like(moved[0])
    for k in range(1, len(time_s)):
        fade = float(np.exp(-(time_s[k] - time_s[k - 1]) / tau_s))
        moved[k] = (moved[k] - creep * fade * memory) / (1 + creep * (1 - fade))
        memory = fade * memory + (1 - fade) * moved[k]
    return moved


def closed(force_N: Float[np.ndarray, "t n 3"], *, share: float) -> Float[np.ndarray, "t n 3"]:
    """One pad's forces without their hysteresis."""
    total = force_N[:, :, 2].sum(axis=1)
    least = max(LEAST_PEAK * float(total.max()), NO_FORCE_N)
    seen = np.clip(total / np.maximum.accumulate(np.maximum(total, least)), 0.0, 1.0)
    r = seen
    for _ in range(TURNS):
        off = r * (1 - 4 * share * r * (1 - r)) - seen
        r = np.clip(r - off / (1 - 8 * share * r + 12 * share * r**2), 0.0, 1.0)
    return np.asarray(force_N / (1 - 4 * share * r * (1 - r))[:, None, None])


@dataclass(frozen=True, kw_only=True)
class GainFault:
    """Recorded force of one pad = `gain` times the true force."""

    pad: str
    gain: float


@dataclass(frozen=True, kw_only=True)
class DriftFault:
    """One pad's recorded normal force grows by `newton_per_s`, evenly over its markers, from frame one on."""

    pad: str
    newton_per_s: float


@dataclass(frozen=True, kw_only=True)
class ComplianceFault:
    """Recorded travel of each jaw exceeds the true one by `mm_per_N` times its normal force."""

    mm_per_N: float


@dataclass(frozen=True, kw_only=True)
class RigFault:
    """Recorded travel of the jaws together exceeds the true one by the rig's displacement at their normal
    force."""

    curve: RigCurve


@dataclass(frozen=True, kw_only=True)
class LagFault:
    """Displacement and force lag pose and aperture by `lag_s` (negative: they lead)."""

    lag_s: float


@dataclass(frozen=True, kw_only=True)
class PoseFault:
    """Recorded pose of one pad = true pose . shift in the gel's plane . tilt about its x axis."""

    pad: str
    shift_mm: tuple[float, float]
    tilt_deg: float


Fault: TypeAlias = GainFault | DriftFault | ComplianceFault | RigFault | LagFault | PoseFault | GelFault


def corrected(recording: Recording, faults: Sequence[Fault], *, source: str = "recording") -> Recording:
    """`recording` as it would be without the faults.

    Forces are corrected first, since a jaw's compliance acts on the true force. A fault of a pad that the
    recording lacks changes nothing. Raises TactileFailure if a rig's curve does not cover a force. The result
    does not depend on the order of `faults`.
    """
    gels = (ThermalFault, ForceLawFault, GelHysteresisFault, GelCreepFault)
    first = (DriftFault, GainFault, *gels, LagFault, ComplianceFault, RigFault, PoseFault)
    in_order = sorted(faults, key=lambda fault: first.index(type(fault)))
    return reduce(partial(_without, source=source), in_order, recording)


def _without(recording: Recording, fault: Fault, *, source: str) -> Recording:
    if isinstance(fault, LagFault):
        return _in_time(recording, fault.lag_s)
    if isinstance(fault, ComplianceFault):
        return _stiff(recording, [fault.mm_per_N * _normal_N(pad) for pad in recording.pads])
    if isinstance(fault, RigFault):
        return _stiff(recording, _given_by_rig(recording, fault.curve, source))
    if isinstance(fault, GelFault):
        forces = [pad.force_N for pad in recording.pads if isinstance(pad, GelPad)]
        largest = max((float(np.linalg.norm(force, axis=2).max()) for force in forces), default=0.0)
        pads = tuple(
            _gel_pad(pad, fault, recording.time_s, largest) if isinstance(pad, GelPad) else pad
            for pad in recording.pads
        )
    else:
        pads = tuple(
            _corrected_pad(pad, fault, recording.time_s) if pad.name == fault.pad else pad
            for pad in recording.pads
        )
    return replace(recording, pads=pads)


def _corrected_pad(
    pad: GelPad | IndenterPad, fault: GainFault | DriftFault | PoseFault, time_s: Float[np.ndarray, " t"]
) -> GelPad | IndenterPad:
    """One pad without a fault of its pose, gain or drift."""
    if isinstance(fault, PoseFault):
        return replace(pad, pose=pad.pose @ np.linalg.inv(misplacement(fault)))
    gain, newton_per_s = (fault.gain, 0.0) if isinstance(fault, GainFault) else (1.0, fault.newton_per_s)
    grown = newton_per_s * (time_s - time_s[0])
    if isinstance(pad, IndenterPad):
        return replace(pad, force_z_N=(pad.force_z_N - grown) / gain)
    force = pad.force_N.copy()
    force[:, :, 2] -= grown[:, None] / force.shape[1]
    return replace(pad, force_N=force / gain)


def misplacement(fault: PoseFault) -> Float[np.ndarray, "4 4"]:
    """Shift . tilt, in the pad frame: the recorded pose relative to the true one."""
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_euler("x", fault.tilt_deg, degrees=True).as_matrix()
    moved[:2, 3] = fault.shift_mm
    return moved


def _in_time(recording: Recording, lag_s: float) -> Recording:
    """Pose, aperture and load cell at the markers' times: p(t - lag).

    They are interpolated, not the markers, whose noise must stay as it is. Before the first and after the
    last frame the machine is assumed to stand still.
    """
    time_s = recording.time_s
    if len(time_s) < 2:
        return recording
    then = np.clip(time_s - lag_s, time_s[0], time_s[-1])
    wrench = recording.wrench_N
    return replace(
        recording,
        aperture_mm=np.interp(then, time_s, recording.aperture_mm),
        wrench_N=None if wrench is None else at_times(then, time_s, wrench),
        pads=tuple(replace(pad, pose=poses_at(then, time_s, pad.pose)) for pad in recording.pads),
    )


def _given_by_rig(recording: Recording, curve: RigCurve, source: str) -> list[Float[np.ndarray, " _t"]]:
    """Displacement of each jaw under load: of two, half of the rig's at its own force.

    Raises TactileFailure (implausible-recording) for a force that the rig's curve does not cover.
    """
    force = [_normal_N(pad) for pad in recording.pads]
    largest = max(float(normal_N.max()) for normal_N in force)
    if not curve.reaches(largest):
        raise TactileProblem.IMPLAUSIBLE_RECORDING.failure(
            f"{source}: found a maximum force of {largest:.3g} N, but the rig calibration ends at "
            f"{curve.largest_N:.3g} N, expected at most {MOST_BEYOND:g} times that. Squeeze the rigid "
            "object equally hard and calibrate again.",
        )
    return [curve.give(normal_N) / len(force) for normal_N in force]


def _stiff(recording: Recording, gave: Sequence[Float[np.ndarray, " _t"]]) -> Recording:
    """Each pad moved back along its z by its jaw's displacement under load; the aperture by the sum of
    both."""
    closing = -1.0 if recording.loading == "grasp" else 1.0
    pads = []
    for pad, back in zip(recording.pads, gave, strict=True):
        pose = pad.pose.copy()
        along = pose[:, :3, 2]
        pose[:, :3, 3] -= back[:, None] * along
        pads.append(replace(pad, pose=pose))
    aperture = recording.aperture_mm - closing * np.sum(gave, axis=0)
    return replace(recording, pads=tuple(pads), aperture_mm=aperture)


def _normal_N(pad: GelPad | IndenterPad) -> Float[np.ndarray, " t"]:
    return pad.force_z_N if isinstance(pad, IndenterPad) else np.asarray(pad.force_N[:, :, 2].sum(axis=1))
