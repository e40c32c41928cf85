"""A grasp of a ball between two gel pads, with everything that is to be found in it known."""

from dataclasses import dataclass, replace

import numpy as np

from tactile.readers.recording import GelPad, Recording

RADIUS_MM = 25.0
KN_MPA_PER_MM = 0.2


@dataclass(frozen=True)
class InjectedGrasp:
    recording: Recording
    onset: dict[str, np.ndarray]
    clean_force_z_N: dict[str, np.ndarray]
    sd_mm: float
    sd_N: float
    lag1: float
    no_contact_frames: int


def gel_pad(
    name, rest_mm, displacement_mm, force_N, *, pose=None, kn=KN_MPA_PER_MM, kt=0.05, **more
) -> GelPad:
    """A pad with these fields, at rest in the fruit frame where no pose is given."""
    still = np.tile(np.eye(4), (len(force_N), 1, 1))
    return GelPad(
        name=name,
        pose=still if pose is None else pose,
        rest_mm=rest_mm,
        displacement_mm=displacement_mm,
        force_N=force_N,
        gel_kn_MPa_per_mm=kn,
        gel_kt_MPa_per_mm=kt,
        **more,
    )


def ball(radius_mm: float, points: int = 6000) -> np.ndarray:
    """Points of a sphere on a Fibonacci spiral, centre in the origin."""
    k = np.arange(points) + 0.5
    height, turn = 1 - 2 * k / points, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - height**2)
    return radius_mm * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])


def held_by(pads, time_s, aperture_mm, *, loading="grasp") -> Recording:
    """A recording of these pads."""
    return Recording(
        fruit_id="f",
        category="plum",
        loading=loading,
        support="free" if loading == "grasp" else "base",
        sensor="injected",
        time_s=time_s,
        aperture_mm=aperture_mm,
        pads=tuple(pads),
    )


def with_pads(recording: Recording, change, only: str | None = None) -> Recording:
    """The recording with `change(pad)` in place of each pad, or of the one of this name."""
    pads = tuple(change(pad) if only in (None, pad.name) else pad for pad in recording.pads)
    return replace(recording, pads=pads)


def frames_of(recording: Recording, frames: slice | np.ndarray) -> Recording:
    """Some of the frames."""
    fields = ("pose", "force_N", "displacement_mm")
    kept = with_pads(
        recording, lambda pad: replace(pad, **{name: getattr(pad, name)[frames] for name in fields})
    )
    return replace(kept, time_s=recording.time_s[frames], aperture_mm=recording.aperture_mm[frames])


def elsewhere(recording: Recording) -> tuple[Recording, np.ndarray]:
    """The grasp turned and shifted as a whole, and the motion."""
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn * np.sign(np.linalg.det(turn)), [30.0, -40.0, 5.0]
    return with_pads(recording, lambda pad: replace(pad, pose=motion @ pad.pose)), motion


def travel_path(air: int, step_mm: float, cycles: int) -> np.ndarray:
    """Jaw travel per pad: in the air, then ramps in, holds, and ramps out again."""
    ramp = np.linspace(-1.2 * step_mm, 7 * step_mm, 9)
    cycle = np.concatenate([ramp, np.full(5, ramp[-1]), ramp[::-1]])
    return np.concatenate([np.full(air, -1.5), *[cycle] * cycles, np.full(10, -1.5)])


def coloured(rng: np.random.Generator, shape: tuple[int, ...], sd: float) -> np.ndarray:
    """A moving average along the first axis with lag-1 correlation 0.3 or so."""
    white = rng.normal(size=(shape[0] + 1, *shape[1:]))
    share = 0.35
    return sd * (white[1:] + share * white[:-1]) / np.hypot(1, share)


def injected_grasp(
    rng: np.random.Generator, *, air: int = 25, step_mm: float = 0.15, cycles: int = 1, noise: float = 1.0
) -> InjectedGrasp:
    """Half of the pads' travel goes into the gel, half into the ball; only normal force."""
    sd_mm, sd_N = 0.004 * noise, 0.001 * noise
    travel = travel_path(air, step_mm, cycles)
    grid = np.arange(-7.0, 7.5, 1.0)
    rest = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    rest = np.column_stack([rest, np.zeros(len(rest))])
    sagitta = (rest**2).sum(axis=1) / (2 * RADIUS_MM)
    pads, onset, clean = [], {}, {}
    for name, side in (("left", -1.0), ("right", 1.0)):
        depth = np.maximum(travel[:, None] - sagitta, 0.0) / 2
        displacement = np.zeros((*depth.shape, 3))
        displacement[:, :, 2] = -depth
        force = np.zeros_like(displacement)
        force[:, :, 2] = KN_MPA_PER_MM * depth
        clean[name] = force[:, :, 2].sum(axis=1)
        onset[name] = np.where((depth > 0).any(axis=0), (depth > 0).argmax(axis=0), -1)
        displacement += (
            coloured(rng, displacement.shape, sd_mm) + rng.normal(size=(1, *rest.shape)) * sd_mm / 2
        )
        force += coloured(rng, force.shape, sd_N) + rng.normal(size=(1, *rest.shape)) * sd_N / 2
        pose = np.tile(np.eye(4), (len(travel), 1, 1))
        pose[:, :3, 2] = [-side, 0, 0]
        pose[:, :3, 0] = [0, 1, 0]
        pose[:, :3, 1] = np.cross(pose[0, :3, 2], pose[0, :3, 0])
        pose[:, 0, 3] = side * (RADIUS_MM - travel)
        pads.append(gel_pad(name, rest, displacement, force, pose=pose))
    recording = held_by(pads, np.arange(len(travel)) * 0.1, 2 * (RADIUS_MM - travel))
    lag1 = 0.35 / (1 + 0.35**2)
    return InjectedGrasp(recording, onset, clean, sd_mm, sd_N, lag1, air)
