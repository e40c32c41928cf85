"""Finer patterns of a recording's forces: what the leading ones leave, smoothed over neighbouring markers.

The leading patterns of prepared forces (fem.estimation.prepared_grasp) leave out where a patch grows and
shifts. That is small, but it is no noise: in a model driven without it sound fruit seem to lie in jaws that
give way, or to be firmer outside. What is left of the forces f - sum_r a_r f_r is smoothed by a Gaussian
kernel S over the markers, each pad by itself, and nothing is left at markers that never touch, where there is
no force. So a pattern at the very rim, next to those, comes out weaker than it is. Of

    S (f - sum_r a_r f_r)

those patterns are added to the others that exceed the greatest that S makes of NOISE_DRAWS draws of noise:
mostly of a grasp that shears and rolls. Markers' own noise differs from marker to marker: S leaves a
twelfth of its variance (4 pi SMOOTHING^2), and the pressure, which is smooth over two or three markers,
nearly whole.
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
"""Added to a recording at most. With six the residual holds more noise again (open-11, the soft ball of
docs/decisions/0008)."""
SMOOTHING = 1.0
"""Standard deviation of the kernel, in markers' pitches. Jaws on the same ball seem to give way by 0.010
mm/N (10 nats) without, 0.004 (none) with it; as many patterns unsmoothed bring noise instead."""
NOISE_DRAWS = 9
"""The greatest of one more draw exceeds all of these in one of ten recordings."""
REACH = 4.0
"""In standard deviations: where the kernel ends."""


@dataclass(frozen=True, kw_only=True)
class FinerPatterns:
    """Numbers `first` to `first` + `count` among a recording's patterns; `smoothing`: S over all markers."""

    first: int
    count: int
    smoothing: Float[np.ndarray, "n n"]

    def of_noise(self, by_pattern: Float[np.ndarray, "p r n 3"]) -> Float[np.ndarray, "p r n 3"]:
        """Noise of the forces by the patterns' courses, as it is in the patterns: smoothed in these."""
        finer = slice(self.first, self.first + self.count)
        if not self.count:
            return by_pattern
        smoothed = by_pattern.copy()
        smoothed[:, finer] = np.einsum("ij,prjx->prix", self.smoothing, by_pattern[:, finer], optimize=True)
        return smoothed


def with_finer_patterns(
    prepared: PreparedGrasp, history: GraspHistory
) -> tuple[PreparedGrasp, FinerPatterns]:
    """`history`: the recording as it was, whose contacts have their rims; a drift's patterns stay last."""
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
    """A draw of the noise that is left in denoised forces, N."""
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
    """S of one pad; a marker that never touches neither takes part nor gets anything."""
    apart = cdist(pad.rest_mm, pad.rest_mm)
    others = apart + np.diag(np.full(len(apart), np.inf))
    distance = apart / (SMOOTHING * np.median(others.min(axis=1)))
    kernel = np.where(distance < REACH, np.exp(-(distance**2) / 2), 0.0)
    kernel /= kernel.sum(axis=1, keepdims=True)
    ever = (pad.episode >= 0).any(axis=0)
    return np.asarray(kernel * np.outer(ever, ever))
