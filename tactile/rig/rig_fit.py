"""Displacement of a rig over force, from squeezes of a rigid object: monotone, stiffening, with its error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.special import ndtri, stdtrit

from tactile.rig.rig_curve import RigCurve
from tactile.rig.rigid_squeeze import RigidPress
from tactile.tactile_failure import TactileFailure, TactileProblem

RAMPS = 10
"""Parts of the force range, at whose ends the slope may change, in addition to Hertz's law. Set by hand."""
KNOTS = 49
"""Knots of the written curve. Between them a PCHIP deviates from Hertz's law in series with a spring by at
most 1e-3 of the largest travel (tests/tactile/test_rig.py)."""
HERTZ = 2 / 3
"""Exponent of the force in the approach of a ball and a flat (Hertz)."""
USUAL_SCALE_SD = 0.05
"""Relative standard deviation of a rig's displacement between squeezes, counted as one more squeeze: a single
recording does not show it. Assumed."""
LEAST_RESOLVED = 3.0
"""Least ratio of largest displacement to scatter about the curve: below it the travel does not resolve the
rig. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class FittedRig:
    """The rig's curve and the contributions to its standard deviation, mm.

    `repeat_mm`: between squeezes, and `scatter_mm`: from the readings' scatter `readings_mm` about the curve,
    both at the largest force. `hysteresis_mm`: half of unloading minus loading travel, where it is largest;
    only clocks that differ make it negative. `least_N`: least force that all squeezes cover. `held`: least
    share of force kept in a hold.
    """

    curve: RigCurve
    least_N: float
    repeat_mm: float
    hysteresis_mm: float
    scatter_mm: float
    readings_mm: float
    squeezes: int
    held: float


def fit_rig(squeezes: Sequence[RigidPress], *, with_gels: bool = True) -> FittedRig:
    """Displacement of the rig over force; without that of the gels (`part_mm`) if `with_gels` is False.

    travel_i = onset_i + s_i sum_k c_k phi_k(F) with c_k >= 0 and phi = F, F^(2/3) and min(F, f_k). Every such
    sum grows with the force and stiffens; a spring in series with a Hertz contact is one exactly. The scales
    s_i, of mean 1, differ between squeezes. One squeeze of USUAL_SCALE_SD adds to their variance:
    s^2 = (0.05^2 + sum (s_i - 1)^2)/n. The next squeeze deviates by s sqrt(1 + 1/n). A factor, the ratio of
    Student's 95 % quantile with max(n, 2) degrees of freedom to the normal one, makes two standard deviations
    cover as often after three squeezes as after thirty.

    The curve is that of loading, up to the least of the squeezes' peaks. Half of its distance from unloading
    is part of its standard deviation, except without the gels: their unloading is unknown. Raises
    TactileFailure (unreadable-frames) if the readings do not resolve the rig.
    """
    force = [squeeze.force_N for squeeze in squeezes]
    travel = [squeeze.travel_mm - (0.0 if with_gels else 1.0) * squeeze.part_mm for squeeze in squeezes]
    largest = min(squeeze.largest_N for squeeze in squeezes)
    inside = [f <= largest * (1 + 1e-9) for f in force]
    force = [f[k] for f, k in zip(force, inside, strict=True)]
    travel = [t[k] for t, k in zip(travel, inside, strict=True)]
    give, active = _shape(force, travel, np.ones(len(force)), largest)
    if active == 0:
        raise _not_resolved(squeezes[0].source, 0.0, largest, max(float(np.ptp(t)) for t in travel))
    scales, onsets = _scales(force, travel, give)
    give, active = _shape(force, travel, scales, largest)
    scales, onsets = _scales(force, travel, give)
    residual = np.concatenate(
        [t - o - s * give(f) for f, t, o, s in zip(force, travel, onsets, scales, strict=True)]
    )
    unknowns = active + 2 * len(force) - 1
    readings = float(np.sqrt(residual @ residual / max(len(residual) - unknowns, 1)))
    peak = float(give(np.array(largest)))
    if not peak > LEAST_RESOLVED * readings:
        raise _not_resolved(squeezes[0].source, peak, largest, readings)
    knots = largest * (np.arange(KNOTS) / (KNOTS - 1)) ** 1.5
    n = len(squeezes)
    few = float(stdtrit(max(n, 2), 0.95) / ndtri(0.95))
    spread = few * float(np.sqrt((USUAL_SCALE_SD**2 + ((scales - 1) ** 2).sum()) / n * (1 + 1 / n)))
    back = np.zeros(KNOTS) if not with_gels else _hysteresis(squeezes, give, scales, onsets, knots)
    scatter = readings * float(np.sqrt(active / len(residual)))
    sd = np.sqrt(
        (spread * give(knots)) ** 2 + back**2 + (scatter * np.minimum(knots / knots[-1] * 4, 1)) ** 2
    )
    return FittedRig(
        curve=RigCurve(force_N=knots, give_mm=give(knots), sd_mm=sd),
        least_N=max(float(f.min()) for f in force),
        repeat_mm=spread * peak,
        hysteresis_mm=float(back[np.argmax(np.abs(back))]),
        scatter_mm=scatter,
        readings_mm=readings,
        squeezes=n,
        held=min(squeeze.held for squeeze in squeezes),
    )


def _not_resolved(source: str, peak: float, largest: float, readings: float) -> TactileFailure:
    return TactileProblem.UNREADABLE_FRAMES.failure(
        f"{source}: found a compliance displacement of {peak:.3g} mm at {largest:.3g} N with readings "
        f"{readings:.2g} mm off one curve, expected at least {LEAST_RESOLVED:.0f} times that. Squeeze "
        "harder, or more slowly. A rig below the resolution of its travel needs no correction.",
    )


_Give: TypeAlias = Callable[[Float[np.ndarray, "*t"]], Float[np.ndarray, "*t"]]
"""sum_k c_k phi_k(F)."""


def _basis(force: Float[np.ndarray, " t"], largest: float) -> Float[np.ndarray, "t k"]:
    """Stiffening curves that compose the displacement, each 1 at the largest force or where it ends."""
    share = force / largest
    ends = (np.arange(1, RAMPS) / RAMPS) ** 1.5
    return np.column_stack([share, share**HERTZ, *(np.minimum(share / end, 1.0) for end in ends)])


def _shape(
    force: list[Float[np.ndarray, " _t"]],
    travel: list[Float[np.ndarray, " _t"]],
    scales: Float[np.ndarray, " n"],
    largest: float,
) -> tuple[_Give, int]:
    """Displacement by non-negative least squares, and its number of terms; each squeeze's mean eliminates its
    onset.

    Each reading weighs the force between its neighbours, so that slow and fast stretches count equally.
    Source: Lawson and Hanson, "Solving Least Squares Problems", 1974, ch. 23.
    """
    rows, values = [], []
    for f, t, s in zip(force, travel, scales, strict=True):
        weight = _weights(f)
        basis = s * _basis(f, largest)
        root = np.sqrt(weight)[:, None]
        rows.append((basis - weight @ basis / weight.sum()) * root)
        values.append((t - weight @ t / weight.sum()) * root[:, 0])
    amounts, _ = nnls(np.vstack(rows), np.concatenate(values))

    def give(force_N: Float[np.ndarray, "*t"]) -> Float[np.ndarray, "*t"]:
        flat = np.ravel(np.maximum(force_N, 0.0))
        return np.asarray((_basis(flat, largest) @ amounts).reshape(np.shape(force_N)))

    return give, int((amounts > 0).sum())


def _scales(
    force: list[Float[np.ndarray, " _t"]], travel: list[Float[np.ndarray, " _t"]], give: _Give
) -> tuple[Float[np.ndarray, " n"], list[float]]:
    """Each squeeze's scale relative to the common curve, of mean 1, and its onset, mm."""
    scales, onsets = [], []
    for f, t in zip(force, travel, strict=True):
        weight, y = _weights(f), give(f)
        y0, t0 = weight @ y / weight.sum(), weight @ t / weight.sum()
        scales.append(float((weight * (y - y0)) @ (t - t0) / ((weight * (y - y0)) @ (y - y0))))
        onsets.append(float(t0 - scales[-1] * y0))
    mean = float(np.mean(scales))
    return np.array(scales) / mean, onsets


def _weights(force: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """Force between the midpoints to the neighbours, plus a tenth of its mean over all readings."""
    order = np.argsort(force)
    gaps = np.gradient(force[order]) if len(force) > 1 else np.ones(1)
    weight = np.empty(len(force))
    weight[order] = np.maximum(gaps, 0.0)
    return np.asarray(weight + 0.1 * weight.mean() + 1e-12)


def _hysteresis(
    squeezes: Sequence[RigidPress],
    give: _Give,
    scales: Float[np.ndarray, " n"],
    onsets: list[float],
    knots: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    """Half of unloading minus loading travel at the knots, mm; 0 if unknown."""
    half_gaps: list[tuple[float, float]] = []
    for squeeze, s, o in zip(squeezes, scales, onsets, strict=True):
        there = (squeeze.back_force_N > 0) & (squeeze.back_force_N <= knots[-1])
        gap = squeeze.back_travel_mm[there] - o - s * give(squeeze.back_force_N[there])
        half_gaps += zip(squeeze.back_force_N[there].tolist(), (0.5 * gap).tolist(), strict=True)
    if len(half_gaps) < 3:
        return np.zeros(len(knots))
    force, gap = np.array(sorted(half_gaps)).T
    parts = np.array_split(np.arange(len(force)), min(8, len(force) // 2 or 1))
    at = np.array([float(np.median(force[k])) for k in parts])
    middle = np.array([float(np.median(gap[k])) for k in parts])
    return np.asarray(np.interp(knots, np.r_[0.0, at, knots[-1]], np.r_[0.0, middle, middle[-1]]))
