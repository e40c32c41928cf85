"""A prepared recording, which drives every model of the fruit and is compared with it: forces without most of
their noise, and contacts without their rims.

The forces are projected on their few leading patterns f_r,

    f(t) = sum_r a_r(t) f_r,

those of the denoised forces (fem.estimation.denoised_force) that exceed noise, at least LEAST_PATTERNS, and
that of zero drift if it is certain (fem.estimation.zero_drift). The other patterns would add noise to the
model's response, and a regression on a noisy regressor is attenuated (errors in variables; Fuller 1987,
Measurement Error Models, section 1.2): E of soft fruit was 5 % too high.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.denoised_force import ABOVE_NOISE, DenoisedForce, denoised_force
from fem.estimation.frame_thinning import loaded_frames, thinned
from fem.estimation.zero_drift import zero_drift
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory, PadHistory, PatternNoise

LEAST_PATTERNS, MOST_PATTERNS = 4, 10
"""Fewest patterns of the forces, even below noise: a contact that grows and shears has them. With fewer, E of
soft fruit was too low, by 1.6 % at 0.25 MPa with noise as the only error and by up to 7 % at 0.15 MPa
(docs/decisions/0012). And most patterns: each costs a solve, and no fruit tried gains by more than five."""
PRESSED = 3.0
"""A marker presses if its normal force exceeds this many standard deviations of its noise."""
FEWEST_PRESSED = 6
"""Fewest pressing markers of a pad in a frame that counts. Set by hand: two determine only its motion, and
nothing about the flesh."""
RIM, PEAK = 0.25, 20
"""Markers below this share of the mean over the PEAK greatest normal forces are on the patch's rim. There the
skin bends away within a marker's width and models are wrong by micrometres, so they are left out."""


@dataclass(frozen=True, kw_only=True)
class PreparedGrasp:
    """`recorded`: the original recording, whose contacts have their rims. `history`: with the forces of the
    patterns, all frames, their noise (`pattern_noise`), and contacts without rims. `used`: the frames to
    which a model is fitted.

    `force_N`: denoised forces of all pads in the frames used, before projection on patterns; `force_sd_N`:
    noise of one component in one frame of them; `coloured_sd_N`: that of white noise with the same variance
    of a mean over frames. `patterns` and `shares`: f_r and a_r(t). `denoised`: how each pad's forces were
    denoised.
    """

    recorded: GraspHistory
    history: GraspHistory
    used: Bool[np.ndarray, " t"]
    force_N: Float[np.ndarray, "f n 3"]
    force_sd_N: float
    coloured_sd_N: float
    patterns: Float[np.ndarray, "r n 3"]
    shares: Float[np.ndarray, "f r"]
    denoised: tuple[DenoisedForce, ...]


def prepared_grasp(history: GraspHistory, turns: Float[np.ndarray, "p 3 3"]) -> PreparedGrasp:
    """`turns`: each pad's axes in the fruit frame, as columns, the last one into the fruit.

    Raises FemFailure (no-load) if no pad presses at FEWEST_PRESSED markers at once.
    """
    grown, drift = _drift(history, turns[:, :, 2])
    drifted = np.tensordot(grown, drift, axes=1)
    whose = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    still = [
        replace(pad, force_N=pad.force_N - drift_N)
        for pad, drift_N in zip(history.pads, np.split(drifted, whose, axis=1), strict=True)
    ]
    contacts = [pressing_contacts(*pair) for pair in zip(still, turns, strict=True)]
    pressing = [replace(pad, episode=episode) for pad, episode in zip(history.pads, contacts, strict=True)]
    if all((episode < 0).all() for episode in contacts):
        raise FemFailure(
            FemProblem.NO_LOAD,
            f"found no frame in which a pad presses on {FEWEST_PRESSED} markers at once, expected a "
            "contact. Press deeper, or use a finer marker grid",
        )
    used = loaded_frames(replace(history, pads=tuple(pressing)))
    felt = [denoised_force(pad, turn, used) for pad, turn in zip(still, turns, strict=True)]
    force = np.concatenate([pad.force_N for pad in felt], axis=1)
    sd_N = max(pad.sd_N for pad in felt)
    coloured_sd_N = sd_N * float(np.sqrt(variance_inflation(np.array([history.pads[0].lag1]))[0]))
    patterns, shares = _patterns(force[used], coloured_sd_N)
    every = force.reshape(len(force), -1) @ patterns.reshape(len(patterns), -1).T
    driving = np.tensordot(every, patterns, axes=1) + drifted
    pads = tuple(
        replace(pad, force_N=force_N)
        for pad, force_N in zip(pressing, np.split(driving, whose, axis=1), strict=True)
    )
    noise = [
        denoised.noise_of(pad_patterns)
        for denoised, pad_patterns in zip(felt, np.split(patterns, whose, axis=1), strict=True)
    ]
    of_displacement, of_force = (np.concatenate(parts, axis=1) for parts in zip(*noise, strict=True))
    return PreparedGrasp(
        recorded=history,
        history=replace(
            history,
            pads=pads,
            pattern_noise=PatternNoise(patterns=patterns, of_displacement=of_displacement, of_force=of_force),
        ),
        used=used,
        force_N=force[used] + drifted[used],
        force_sd_N=sd_N,
        coloured_sd_N=coloured_sd_N,
        patterns=np.concatenate([patterns, drift]),
        shares=np.column_stack([shares, grown[used]]),
        denoised=tuple(felt),
    )


def thinned_grasp(prepared: PreparedGrasp, most_frames: int) -> PreparedGrasp:
    """At most so many of the frames used, evenly spread, with the patterns and noise of all frames."""
    used = thinned(prepared.used, most=most_frames)
    kept = used[prepared.used]
    return replace(prepared, used=used, force_N=prepared.force_N[kept], shares=prepared.shares[kept])


def pressing_contacts(pad: PadHistory, turn: Float[np.ndarray, "3 3"]) -> Int[np.ndarray, "t n"]:
    """Numbers of contacts without rims and without frames of a released pad, with a new number after these.

    A marker that stops for a single frame is still in contact (tactile's episodes bridge it): one may be
    noise. If fewer than FEWEST_PRESSED markers of the pad press, it is released.
    """
    normal = pad.force_N @ turn[:, 2]
    pressed = (normal > PRESSED * pad.force_sd_N) & (pad.episode >= 0)
    loose = pressed.sum(axis=1) < FEWEST_PRESSED
    gone = np.cumsum(loose)[:, None]
    peak = np.sort(normal, axis=1)[:, -PEAK:].mean(axis=1)
    inside = pressed & (normal > RIM * peak[:, None]) & ~loose[:, None]
    number = np.where(inside, pad.episode + gone, -1)
    known = np.unique(number[number >= 0])
    return np.where(number >= 0, np.searchsorted(known, number), -1)


def _drift(
    history: GraspHistory, normals: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "t d"], Float[np.ndarray, "d n 3"]]:
    """Zero drift in the recorded forces of pads with certain drift: its time course, and unit patterns.

    It is evenly spread and so small on each marker that noise would hide it. So it is subtracted before
    patterns are separated from noise.
    """
    shares, patterns = [], []
    for pad, normal in enumerate(normals):
        drifting = zero_drift(history, pad, normal)
        if drifting is None or not drifting.sure:
            continue
        on_pad = history.pad_of_marker == pad
        size = np.sqrt(on_pad.sum())
        shares.append(drifting.grown_N(history.time_s) / size)
        patterns.append(on_pad[:, None] * normal / size)
    count = len(history.pad_of_marker)
    return (
        np.reshape(shares, (len(shares), len(history.time_s))).T,
        np.reshape(patterns, (len(patterns), count, 3)),
    )


def _patterns(
    force_N: Float[np.ndarray, "f n 3"], sd_N: float
) -> tuple[Float[np.ndarray, "r n 3"], Float[np.ndarray, "f r"]]:
    """The leading patterns that exceed those of noise alone (Marchenko and Pastur 1967), and further ones up
    to LEAST_PATTERNS.
    """
    flat = force_N.reshape(len(force_N), -1)
    left, size, right = np.linalg.svd(flat, full_matrices=False)
    above = size[:MOST_PATTERNS] > ABOVE_NOISE * sd_N * (np.sqrt(flat.shape[0]) + np.sqrt(flat.shape[1]))
    count = min(len(size), max(LEAST_PATTERNS, int(above.sum())))
    return right[:count].reshape(count, -1, 3), left[:, :count] * size[:count]
