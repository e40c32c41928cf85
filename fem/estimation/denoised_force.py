"""The forces of a marker gel without most of their noise, from its displacement and leading patterns.

Most gels act as springs: f = A d at each marker, with one stiffness along the pad's normal and one across,
fitted to the recording itself (so that a gain error is kept). Displacement is then the better force sensor:
f = A d contains the noise of d alone. Of the recorded forces less A d, patterns that exceed noise are kept (a
drift, a gel that relaxes, one that is no bed of springs). The rest is noise, and noise in the forces causes
false motion in every model that they drive.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.coloured_noise import variance_inflation
from fem.grasp_history import PadHistory

ABOVE_NOISE = 1.5
"""A pattern counts if it is this many times the greatest one of noise alone (Marchenko and Pastur 1967)."""


@dataclass(frozen=True, kw_only=True)
class DenoisedForce:
    """`force_N` in the fruit frame, all frames; `sd_N`: its noise, of one component in one frame.

    It is A d + Q (f - A d): `stiffness_N_per_mm`, the diagonal of A along the pad's axes `turn` (columns, in
    the fruit frame), and `kept`, the orthonormal patterns (rows, pad axes) that Q projects on; None: Q = 1,
    the forces as recorded.
    """

    force_N: Float[np.ndarray, "t n 3"]
    sd_N: float
    turn: Float[np.ndarray, "3 3"]
    stiffness_N_per_mm: Float[np.ndarray, "3"]
    kept: Float[np.ndarray, "q d"] | None

    def noise(
        self, displacement_mm: Float[np.ndarray, "t n 3"], force_N: Float[np.ndarray, "t n 3"]
    ) -> Float[np.ndarray, "t n 3"]:
        """Noise of `force_N` by noise of displacement and of force (fruit frame, any number of frames)."""
        moved, force = displacement_mm @ self.turn, force_N @ self.turn
        if self.kept is None:
            return np.asarray(force @ self.turn.T)
        springs = moved * self.stiffness_N_per_mm
        beyond = (force - springs).reshape(len(force), -1)
        more = ((beyond @ self.kept.T) @ self.kept).reshape(force.shape)
        return np.asarray((springs + more) @ self.turn.T)

    def noise_of(
        self, patterns: Float[np.ndarray, "r n 3"]
    ) -> tuple[Float[np.ndarray, "r n 3"], Float[np.ndarray, "r n 3"]]:
        """Derivatives of the amounts of patterns f_r (fruit frame) by the markers' displacement,
        A (1 - Q) f_r (N/mm), and by their recorded force, Q f_r.
        """
        turned = (patterns @ self.turn).reshape(len(patterns), -1)
        of_force = turned if self.kept is None else (turned @ self.kept.T) @ self.kept
        of_displacement = (turned - of_force).reshape(patterns.shape) * self.stiffness_N_per_mm
        return of_displacement @ self.turn.T, of_force.reshape(patterns.shape) @ self.turn.T


def denoised_force(
    pad: PadHistory, turn: Float[np.ndarray, "3 3"], used: Bool[np.ndarray, " t"]
) -> DenoisedForce:
    """`turn`: pad axes in the fruit frame, as columns; `used`: the frames that separate patterns from
    noise."""
    force = pad.force_N @ turn
    moved = pad.gel_displacement_mm @ turn
    stiffness = np.array([_slope(force[used], moved[used], part, pad) for part in ([0, 1], [2])])[[0, 0, 1]]
    noise = float(np.abs(stiffness).max()) * pad.displacement_sd_mm
    if noise > pad.force_sd_N:  # displacement is noisier than the forces themselves
        return DenoisedForce(
            force_N=pad.force_N, sd_N=pad.force_sd_N, turn=turn, stiffness_N_per_mm=np.zeros(3), kept=None
        )
    springs = moved * stiffness
    beyond = (force - springs).reshape(len(force), -1)
    _, size, right = np.linalg.svd(beyond[used], full_matrices=False)
    sd = pad.force_sd_N * float(np.sqrt(variance_inflation(np.array([pad.lag1]))[0]))
    kept = right[size > ABOVE_NOISE * sd * (np.sqrt(used.sum()) + np.sqrt(beyond.shape[1]))]
    more = (beyond @ kept.T) @ kept
    return DenoisedForce(
        force_N=(springs + more.reshape(force.shape)) @ turn.T,
        sd_N=max(noise, 1e-9),
        turn=turn,
        stiffness_N_per_mm=stiffness,
        kept=kept,
    )


def _slope(
    force: Float[np.ndarray, "f n 3"], moved: Float[np.ndarray, "f n 3"], part: list[int], pad: PadHistory
) -> float:
    """Force over displacement by least squares over all markers, along time courses of the pad's total force.

    All markers count, since touching ones are selected by their force. If that is only a few times its noise,
    the selection favours positive noise, and the slope is a tenth too steep. Displacement noise makes the
    slope too small: along those courses it is averaged over frames, and the remaining noise is subtracted.
    """
    course = np.linalg.qr(force.sum(axis=1))[0]
    f, d = (np.einsum("tk,tnx->knx", course, values[..., part]) for values in (force, moved))
    inflation = float(variance_inflation(np.array([pad.lag1]))[0])
    noise = pad.displacement_sd_mm**2 * inflation * d.size
    signal = float((d**2).sum()) - noise
    return float((f * d).sum()) / signal if signal > noise else 0.0
