"""Finer patterns of a recording's forces: the leading ones' residual, smoothed over neighbouring markers.

The leading patterns of prepared forces (fem.estimation.prepared_grasp) miss the growth and shift of a patch.
These are small, but no noise: without them, fruit without mismatch seem to lie in compliant jaws, or to be
firmer outside. A Gaussian kernel S over the markers of each pad smooths the residual f - sum_r a_r f_r. It is
set to zero at markers that never touch, where there is no force. So a pattern at the very rim, next to those,
is too weak. Patterns of

    S (f - sum_r a_r f_r)

are added to the others if they exceed the greatest pattern of S times noise in NOISE_DRAWS draws: mostly in a
grasp that shears and rolls. Noise is independent between markers: S leaves a twelfth of its variance
(4 pi SMOOTHING^2), and nearly all of the pressure, which is smooth over two or three markers.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.spatial.distance import cdist

from fem.estimation.coloured_noise import drawn_coloured_noise
from fem.estimation.frame_thinning import spacing
from fem.estimation.prepared_grasp import PreparedGrasp
from fem.grasp_history import GraspHistory, PadHistory

MOST_FINER = 4
"""Most patterns added to a recording. With six the residual has more noise again (open-11, the soft ball of
docs/decisions/0008)."""
SMOOTHING = 1.0
"""Standard deviation of the kernel, in markers' pitches. On the same ball the jaws' apparent compliance is
0.010 mm/N (log Bayes factor 10) without it, 0.004 (none) with it; as many unsmoothed patterns add noise."""
NOISE_DRAWS = 9
"""Draws of noise: one more draw exceeds all of these in one of ten recordings."""
REACH = 4.0
"""Radius of the kernel, in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class FinerPatterns:
    """Patterns `first` to `first` + `count` of a recording; `smoothing`: S over all markers."""

    first: int
    count: int
    smoothing: Float[np.ndarray, "n n"]

    def of_noise(self, by_pattern: Float[np.ndarray, "p r n 3"]) -> Float[np.ndarray, "p r n 3"]:
        """Noise of the forces along the patterns' time courses, smoothed for the finer patterns."""
        finer = slice(self.first, self.first + self.count)
        if not self.count:
            return by_pattern
        smoothed = by_pattern.copy()
        smoothed[:, finer] = np.einsum("ij,prjx->prix", self.smoothing, by_pattern[:, finer], optimize=True)
        return smoothed


def with_finer_patterns(
    prepared: PreparedGrasp, history: GraspHistory
) -> tuple[PreparedGrasp, FinerPatterns]:
    """`history`: the original recording, whose contacts have their rims; a drift's patterns stay last."""
    smoothing = np.asarray(block_diag(*[_smoothing_of(pad) for pad in history.pads]))
    course = np.linalg.qr(prepared.shares)[0]
    left_N = prepared.force_N - np.tensordot(prepared.shares, prepared.patterns, axes=1)
    smooth = np.einsum("ij,fjx->fix", smoothing, left_N, optimize=True).reshape(len(left_N), -1)
    greatest_N = 0.0
    for seed in range(NOISE_DRAWS):
        noise_N = np.einsum("ij,fjx->fix", smoothing, _noise(prepared, history, seed), optimize=True)
        noise_N = noise_N.reshape(smooth.shape)
        noise_N -= course @ (course.T @ noise_N)
        greatest_N = max(greatest_N, float(np.linalg.norm(noise_N, ord=2)))
    courses, size, shapes = np.linalg.svd(smooth, full_matrices=False)
    count = min(MOST_FINER, int((size > greatest_N).sum()))
    noise = prepared.history.pattern_noise
    first = len(prepared.patterns) if noise is None else len(noise.patterns)
    leading, last = np.split(prepared.patterns, [first])
    courses_of_leading, of_last = np.split(prepared.shares, [first], axis=1)
    more = courses[:, :count] * size[:count]
    finer = replace(
        prepared,
        patterns=np.concatenate([leading, shapes[:count].reshape(count, *leading.shape[1:]), last]),
        shares=np.column_stack([courses_of_leading, more, of_last]),
    )
    return finer, FinerPatterns(first=first, count=count, smoothing=smoothing)


def _noise(prepared: PreparedGrasp, history: GraspHistory, seed: int) -> Float[np.ndarray, "f n 3"]:
    """A draw of the noise in denoised forces, N."""
    rng, apart = np.random.default_rng(seed), spacing(prepared.used)
    frames = int(prepared.used.sum())
    return np.concatenate(
        [
            denoised.sd_N * drawn_coloured_noise((1, frames, len(pad.rest_mm), 3), pad.lag1**apart, rng)[0]
            for pad, denoised in zip(history.pads, prepared.denoised, strict=True)
        ],
        axis=1,
    )


def _smoothing_of(pad: PadHistory) -> Float[np.ndarray, "n n"]:
    """S of one pad, with zero rows and columns for markers that never touch."""
    apart = cdist(pad.rest_mm, pad.rest_mm)
    others = apart + np.diag(np.full(len(apart), np.inf))
    distance = apart / (SMOOTHING * np.median(others.min(axis=1)))
    kernel = np.where(distance < REACH, np.exp(-(distance**2) / 2), 0.0)
    kernel /= kernel.sum(axis=1, keepdims=True)
    ever = (pad.episode >= 0).any(axis=0)
    return np.asarray(kernel * np.outer(ever, ever))
