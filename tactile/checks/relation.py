"""How force and displacement of one gel relate: gain, correlations over frames, markers and axes, delay.

Both are measured at the same markers at the same instants, and a gel's law ties them (tactile/checks/
gel_law.py): with U the displacement felt and V the one that the forces make, V = U but for noise. What is
said of these numbers is tactile/checks/relation_findings.py's; `benchmarks/field_spreads.py` prints those of
sound recordings.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactile.checks.pressing import Pressing, gives_way, heaviest, mean_sd

MOST_LAG, LAG_SHARE = 15, 4
"""Frames, and part of all, up to which a delay is tried."""
FEWEST_OVER_MARKERS, CLEAR_SHARE = 9, 0.2
"""Markers that make a correlation over them, and the share of the variance that must not be noise."""
SEEN_SD = 2.5
"""Spread over markers beyond so many standard deviations of a mean's noise is no noise."""
NOISE_FOR_SLOPES = 0.06
"""Noise over peak of the less noisy field, up to which its bins, 15 % of the peak wide, tell a saturation."""


@dataclass(frozen=True, kw_only=True)
class Relation:
    """Of one pad: V over U, correlations over frames, markers and axes, the delay of V against U, saturation.

    `gain_sd`: relative standard deviation of `gain`, the slope of V on U, by what the slope leaves of V.
    `lag_frames`: by how many frames V is late, with the correlation there; `axes[i, j]` correlates component
    i of V with component j of U; `saturation` is the slope above half the peak over that below; `summed` the
    correlation of V with U summed over frames (U written as increments).
    """

    felt_mm: float
    gel_mm: float
    gain: float
    gain_sd: float
    in_time: float
    over_markers: float
    axes: Float[np.ndarray, "3 3"]
    lag_frames: int
    at_lag: float
    saturation: float
    summed: float


def relation_of(one: Pressing) -> Relation | None:
    """How the pad's forces and displacements relate; None where no marker is pressed or no law is known."""
    if one.gel_mm is None or not one.touched.any() or not gives_way(one):
        return None
    use = one.touched
    felt, gel = one.felt_mm[:, use], one.gel_mm[:, use]
    U, V = felt[:, :, 2].sum(axis=1), gel[:, :, 2].sum(axis=1)
    top = heaviest(one)
    lag, at_lag = _lag(U, V)
    return Relation(
        felt_mm=float(np.abs(U).max()),
        gel_mm=float(np.abs(V).max()),
        gain=_slope(U, V),
        gain_sd=_slope_sd(U, V),
        in_time=_correlation(U, V),
        over_markers=_over_markers(one, top, use),
        axes=_axes(one, felt[top].mean(axis=0), gel[top].mean(axis=0), frames=len(top)),
        lag_frames=lag,
        at_lag=at_lag,
        saturation=_saturation(felt[:, :, 2], gel[:, :, 2], noise=(one.felt_sd_mm, one.gel_sd_mm)),
        summed=_correlation(np.cumsum(U), V),
    )


def _correlation(a: Float[np.ndarray, " t"], b: Float[np.ndarray, " t"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


def _over_markers(one: Pressing, frames: np.ndarray, use: Bool[np.ndarray, " n"]) -> float:
    """Correlation over markers of U and V in these frames' mean, divided by what noise leaves of it."""
    if one.gel_mm is None or use.sum() < FEWEST_OVER_MARKERS:
        return 1.0
    u, v = (x[frames][:, use, 2].mean(axis=0) for x in (one.felt_mm, one.gel_mm))
    noise = [mean_sd(s, len(frames)) ** 2 for s in (one.felt_sd_mm, one.gel_sd_mm)]
    share = [max(1 - n / max(float(x.var()), 1e-30), 0.0) for n, x in zip(noise, (u, v), strict=True)]
    if min(share) < CLEAR_SHARE:
        return 1.0
    return _correlation(u, v) / float(np.sqrt(share[0] * share[1]))


def _axes(
    one: Pressing, u: Float[np.ndarray, "m 3"], v: Float[np.ndarray, "m 3"], *, frames: int
) -> Float[np.ndarray, "3 3"]:
    """Correlations over markers of the components' means over some frames; 0 where noise hides one."""
    if len(u) < FEWEST_OVER_MARKERS:
        return np.eye(3)
    u, v = u - u.mean(axis=0), v - v.mean(axis=0)
    su, sv = u.std(axis=0), v.std(axis=0)
    seen_u, seen_v = (
        x > SEEN_SD * mean_sd(sd, frames) for x, sd in ((su, one.felt_sd_mm), (sv, one.gel_sd_mm))
    )
    both = v.T @ u / len(u) / np.maximum(sv[:, None] * su[None], 1e-30)
    return np.asarray(np.where(seen_v[:, None] & seen_u[None], both, 0.0))


def _lag(U: Float[np.ndarray, " t"], V: Float[np.ndarray, " t"]) -> tuple[int, float]:
    """Frames by which V follows U best, and the correlation there."""
    most = max(1, min(len(U) // LAG_SHARE, MOST_LAG))
    found = {}
    for lag in range(-most, most + 1):
        a = U[max(0, -lag) : len(U) - max(0, lag)]
        b = V[max(0, lag) : len(V) - max(0, -lag)]
        found[lag] = _correlation(a, b)
    best = max(found, key=lambda lag: found[lag])
    return best, found[best]


def _saturation(
    u: Float[np.ndarray, "t m"], v: Float[np.ndarray, "t m"], *, noise: tuple[float, float]
) -> float:
    """Slope of V on U above half the peak over that below, by means in bins of the one with less noise."""
    peaks = float(np.abs(u).max()), float(np.abs(v).max())
    if min(peaks) <= 0:
        return 1.0
    a, b = (u / peaks[0]).ravel(), (v / peaks[1]).ravel()
    by_u = noise[0] / peaks[0] <= noise[1] / peaks[1]
    level = a if by_u else b
    if (noise[0] / peaks[0] if by_u else noise[1] / peaks[1]) > NOISE_FOR_SLOPES:
        return 1.0
    top = float(np.quantile(level, 1 - min(0.02, 20 / len(level))))
    edges = top * np.array([0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.01])
    place = np.digitize(level, edges)
    bins = [place == k for k in range(1, len(edges)) if (place == k).sum() >= 8]
    if len(bins) < 5:
        return 1.0
    x, y = (np.array([float(w[k].mean()) for k in bins]) for w in (a, b))
    half = len(x) // 2
    lower, upper = (_slope(x[s], y[s]) for s in (slice(0, half + 1), slice(half, None)))
    return max(upper, 1e-6) / max(lower, 1e-6)


def _slope(x: Float[np.ndarray, " t"], y: Float[np.ndarray, " t"]) -> float:
    about = x - x.mean()
    return float(about @ y / max(float(about @ about), 1e-30))


def _slope_sd(x: Float[np.ndarray, " t"], y: Float[np.ndarray, " t"]) -> float:
    """Relative standard deviation of `_slope`: sqrt(c sum r^2 / ((t - 2) sum (x - mean x)^2)) over the slope.

    r is what the slope leaves of y; c = (1 + rho) / (1 - rho) with the correlation rho of r between
    neighbouring frames, since errors that last count as fewer frames.
    """
    slope, about = _slope(x, y), x - x.mean()
    left = y - y.mean() - slope * about
    square = float(left @ left)
    rho = float(np.clip(left[1:] @ left[:-1] / max(square, 1e-30), 0.0, 0.9))
    variance = (1 + rho) / (1 - rho) * square / max(len(x) - 2, 1)
    return float(np.sqrt(variance / max(float(about @ about), 1e-30)) / max(abs(slope), 1e-12))
