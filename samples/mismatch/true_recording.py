"""The recording of one grasp before any sensor: frames of contact, and the machine's poses and times."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float

from samples.gel_contact import Gel
from samples.grasp_plan import Hold, Motion, PlannedGrasp
from samples.mismatch.gel_bed import bed_of
from samples.mismatch.grip import Grip, InnerContact, Instant, before_touch, next_instant
from samples.mismatch.marker_sensor import SensorNoise, measured
from samples.mismatch.meshed_fruit import MeshedFruit
from samples.mismatch.skin_compliance import SkinCompliance
from tactile.readers.recording import GelPad, Recording


class GrippedBody(Protocol):
    """A fruit under load. `still`: an instant with unmoved pads equals the previous one."""

    @property
    def still(self) -> bool:
        """Whether the body has no creep."""
        ...

    def begin(self) -> Float[np.ndarray, " d"]:
        """The unloaded skin's displacement after a rest since the last grasp, mm."""
        ...

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """The instant `pause_s` later with the pads at `origins`. Raises NotInEquilibrium."""
        ...


class ElasticBody:
    """Linear flesh without memory. Unknowns other than the skin's belong to an inner contact."""

    still = True

    def __init__(self, compliance: SkinCompliance) -> None:
        self._compliance, self._nowhere = compliance, np.zeros(len(compliance))

    def begin(self) -> Float[np.ndarray, " d"]:
        """Zero displacement."""
        return self._nowhere

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float  # noqa: ARG002
    ) -> Instant:  # fmt: skip
        """Equilibrium with the pads at `origins`."""
        return next_instant(grip, before, origins, self._compliance, self._nowhere)


class SofteningGelBody:
    """A body whose gels soften by 1 - g + g exp(-t/tau); t is the time of contact."""

    still = False

    def __init__(self, body: GrippedBody, *, g: float, tau_s: float) -> None:
        self._body, self._g, self._tau_s = body, g, tau_s
        self._pressed_s = 0.0

    def begin(self) -> Float[np.ndarray, " d"]:
        """The body's unloaded skin; also resets the time of contact."""
        self._pressed_s = 0.0
        return self._body.begin()

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """Equilibrium with the softened gels."""
        self._pressed_s = self._pressed_s + pause_s if np.any(before.force_N) else 0.0
        left, right = grip.gels
        soft = replace(grip, gels=(self._softened(left), self._softened(right)))
        return self._body.advance(soft, before, origins, pause_s)

    def _softened(self, gel: Gel) -> Gel:
        left = 1 - self._g + self._g * float(np.exp(-self._pressed_s / self._tau_s))
        return replace(gel, kn_MPa_per_mm=gel.kn_MPa_per_mm * left, kt_MPa_per_mm=gel.kt_MPa_per_mm * left)


PAD_NAMES = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class PadTruth:
    """One pad: poses (pad to fruit), marker displacement (mm) and force (N), pad frame."""

    pose: Float[np.ndarray, "t 4 4"]
    displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]


@dataclass(frozen=True, kw_only=True)
class TrueRecording:
    """The true values at the frames; pads are left, right, `gel` is the left one's."""

    name: str
    time_s: Float[np.ndarray, " t"]
    aperture_mm: Float[np.ndarray, " t"]
    rest_mm: Float[np.ndarray, "n 3"]
    gel: Gel
    pads: tuple[PadTruth, PadTruth]

    @property
    def marker_area_mm2(self) -> float:
        """Area of the square of gel that each marker represents."""
        places = np.unique(self.rest_mm[:, 0])
        return float(places[1] - places[0]) ** 2

    def with_pads(
        self, change: Callable[[PadTruth], PadTruth], *, only: str | None = None
    ) -> "TrueRecording":
        """The recording with each pad changed, or only the pad of that name."""
        left, right = (
            change(pad) if only in (None, name) else pad
            for name, pad in zip(PAD_NAMES, self.pads, strict=True)
        )
        return replace(self, pads=(left, right))

    @property
    def peak_force_N(self) -> float:
        """Largest total normal force of a pad over the recording."""
        return max(float(p.force_N.sum(axis=1)[:, 2].max()) for p in self.pads)


def grip_of(
    stands: MeshedFruit,
    *,
    gel: Gel | tuple[Gel, Gel],
    inner: InnerContact | None = None,
) -> Grip:
    """The grip on a meshed fruit. `gel`: one for both pads, or one for each."""
    nodes = stands.flesh.bricks.nodes_mm
    local = [
        (nodes[p.nodes] - touch) @ p.turn for p, touch in zip(stands.patches, stands.touch_mm, strict=True)
    ]
    return Grip(
        patches=stands.patches,
        rest_mm=tuple(nodes[p.nodes] for p in stands.patches),
        beds=tuple(bed_of(stands.sensor, x, p.cells) for p, x in zip(stands.patches, local, strict=True)),
        gels=gel if isinstance(gel, tuple) else (gel, gel),
        inner=inner,
    )


def grasped(
    grasp: PlannedGrasp,
    grip: Grip,
    body: GrippedBody,
    *,
    watch: Callable[[int, Instant], None] | None = None,
) -> TrueRecording:
    """Simulate the motion from corner to corner; keep the recorded corners.

    `watch` gets each corner's number and instant. Raises NotInEquilibrium if a step does not converge.
    """
    hold, motion = grasp.hold, grasp.motion
    instant = before_touch(grip, _origins(hold, motion, 0), body.begin())
    frames = [instant]
    for k in range(1, len(motion.time_s)):
        if watch is not None:
            watch(k - 1, instant)
        pause = float(motion.time_s[k] - motion.time_s[k - 1])
        origins = _origins(hold, motion, k)
        unmoved = np.array_equal(origins, instant.origins)
        if not (unmoved and body.still):
            instant = body.advance(grip, instant, origins, pause)
        if motion.recorded[k]:
            frames.append(instant)
    if watch is not None:
        watch(len(motion.time_s) - 1, instant)
    return _at_frames(grasp, grip, frames, _markers_mm(grip))


def as_measured(
    truth: TrueRecording,
    *,
    gels: tuple[Gel, Gel],
    noise: SensorNoise,
    rng: np.random.Generator,
    fruit_id: str,
    category: str,
    sensor: str,
    origin_mm: Float[np.ndarray, " 3"] | None = None,
) -> Recording:
    """The recording with sensor noise; `origin_mm`: origin of its frame (None: that of the truth)."""
    pads = []
    for name, gel, pad in zip(PAD_NAMES, gels, truth.pads, strict=True):
        felt, pushed = measured(pad.displacement_mm, pad.force_N, noise, rng)
        pose = pad.pose.copy()
        if origin_mm is not None:
            pose[:, :3, 3] -= origin_mm
        pads.append(
            GelPad(
                name=name,
                pose=pose,
                rest_mm=truth.rest_mm,
                displacement_mm=felt,
                force_N=pushed,
                gel_kn_MPa_per_mm=gel.kn_MPa_per_mm,
                gel_kt_MPa_per_mm=gel.kt_MPa_per_mm,
            )
        )
    return Recording(
        fruit_id=fruit_id,
        category=category,
        loading="grasp",
        support="free",
        sensor=sensor,
        time_s=truth.time_s,
        aperture_mm=truth.aperture_mm,
        pads=tuple(pads),
    )


def _markers_mm(grip: Grip) -> Float[np.ndarray, "n 3"]:
    places = grip.beds[0].points_mm[-grip.beds[0].markers :]
    return np.concatenate([places, np.zeros((len(places), 1))], axis=1)


def _origins(hold: Hold, motion: Motion, k: int) -> Float[np.ndarray, "2 3"]:
    origins = hold.origins(float(motion.travel_mm[k]))
    return np.asarray(origins + np.stack([motion.shear_mm[k] * hold.turns[0][:, 0], np.zeros(3)]))


def _at_frames(
    grasp: PlannedGrasp, grip: Grip, frames: list[Instant], rest_mm: Float[np.ndarray, "n 3"]
) -> TrueRecording:
    """The recording at the recorded frames, in the pads' order."""
    hold, motion = grasp.hold, grasp.motion
    shown = motion.recorded
    travel = motion.travel_mm[shown]
    gap = float(np.linalg.norm(hold.touch_mm[1] - hold.touch_mm[0]))
    pads = []
    for side in (1, 0) if grasp.turned else (0, 1):
        pose = np.broadcast_to(np.eye(4), (len(frames), 4, 4)).copy()
        pose[:, :3, :3] = hold.turns[side]
        pose[:, :3, 3] = [f.origins[side] for f in frames]
        pads.append(
            PadTruth(
                pose=pose,
                displacement_mm=np.stack([f.marker_shift_mm[side] for f in frames]),
                force_N=np.stack([f.marker_force_N[side] for f in frames]),
            )
        )
    return TrueRecording(
        name=grasp.name, time_s=motion.time_s[shown], aperture_mm=gap - 2 * travel, rest_mm=rest_mm,
        gel=grip.gels[0], pads=(pads[0], pads[1]),
    )  # fmt: skip
