"""How force and displacement of one gel relate, and what is wrong where they do not agree: a unit, a sign, an
axis, a delay, an order, a gain.

Both are measured at the same markers at the same instants, and a gel's law ties them
(tactile/checks/pressing.py): with U the displacement felt and V the one that the forces make, V = U but for
noise. Numbers that sound recordings show stand beside each limit (`benchmarks/field_spreads.py`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactile.checks.finding import Field, Finding, FindingKind, FindingRank, shared
from tactile.checks.gain_findings import GAIN_SAID, gain_findings
from tactile.checks.pressing import Pressing, gives_way, heaviest, mean_sd, peak_normal, peak_total_N

MOST_LAG, LAG_SHARE = 15, 4
"""Frames, and part of all, up to which a delay is tried."""
FEWEST_OVER_MARKERS, CLEAR_SHARE = 9, 0.2
"""Markers that make a correlation over them, and the share of the variance that must not be noise."""
SEEN_SD = 2.5
"""Spread over markers beyond so many standard deviations of a mean's noise is no noise."""
NOISE_FOR_SLOPES = 0.06
"""Noise over peak of the less noisy field, up to which its bins, 15 % of the peak wide, tell a saturation."""
AXES = "xyz"
DEAD, FLAT_SD = 0.02, 2.0
"""A field is dead whose total stays below this share of what the other one says, with a root mean square over
the markers of no frame beyond so many standard deviations of noise; sound fields have 0.94 to 1.06 of it
(benchmarks/field_spreads.py)."""
IN_STEP, OUT_OF_STEP = 0.97, 0.93
"""Correlation over frames of the totals of U and V; sound recordings have 0.99 and more
(benchmarks/field_spreads.py)."""
LAG_BETTER = 0.03
"""By how much the correlation at a delay exceeds that without."""
SAME_MARKERS = 0.6
"""Correlation of U and V over markers at the peak, over what noise leaves of it; sound: 1.0 and more
(benchmarks/field_spreads.py; above 1 since noise is overestimated), markers in chance order: 0.0."""
ON_ANOTHER_AXIS, BETTER = 0.8, 0.02
"""Correlation over markers, and by how much it exceeds that of the normal parts; in sound recordings these
have 0.98 and more and shear has less, by 0.05 at least."""
IN_PLANE = (0.5, 0.3)
"""x and y are exchanged where both cross correlations exceed the first and none of their own the second."""
NOT_FRICTION, OVER_NOISE = 2.5, 10.0
"""Mean along another axis over that along z (friction of 1 allows 1, sound ones have 0.07 and less in
benchmarks/field_spreads.py), and over the mean's own noise."""
SATURATES = 0.6
"""Slope of V on U above half the peak over the slope below; sound 0.97 to 1.06, noisy ones 0.67 to 1.25, a
sensor that reads a quarter less at its peak 0.7 (benchmarks/field_spreads.py)."""


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


def relation_of(press: Pressing) -> Relation | None:
    """How the pad's forces and displacements relate; None where no marker is pressed or no law is known."""
    if press.gel_mm is None or not press.touched.any() or not gives_way(press):
        return None
    use = press.touched
    felt, gel = press.felt_mm[:, use], press.gel_mm[:, use]
    U, V = felt[:, :, 2].sum(axis=1), gel[:, :, 2].sum(axis=1)
    top = heaviest(press)
    lag, at_lag = _lag(U, V)
    return Relation(
        felt_mm=float(np.abs(U).max()),
        gel_mm=float(np.abs(V).max()),
        gain=_slope(U, V),
        gain_sd=_slope_sd(U, V),
        in_time=_correlation(U, V),
        over_markers=_over_markers(press, top, use),
        axes=_axes(press, felt[top].mean(axis=0), gel[top].mean(axis=0), frames=len(top)),
        lag_frames=lag,
        at_lag=at_lag,
        saturation=_saturation(felt[:, :, 2], gel[:, :, 2], noise=(press.felt_sd_mm, press.gel_sd_mm)),
        summed=_correlation(np.cumsum(U), V),
    )


def _correlation(a: Float[np.ndarray, " t"], b: Float[np.ndarray, " t"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


def _over_markers(press: Pressing, frames: np.ndarray, use: Bool[np.ndarray, " n"]) -> float:
    """Correlation over markers of U and V in these frames' mean, divided by what noise leaves of it."""
    if press.gel_mm is None or use.sum() < FEWEST_OVER_MARKERS:
        return 1.0
    u, v = (x[frames][:, use, 2].mean(axis=0) for x in (press.felt_mm, press.gel_mm))
    noise = [mean_sd(s, len(frames)) ** 2 for s in (press.felt_sd_mm, press.gel_sd_mm)]
    share = [max(1 - n / max(float(x.var()), 1e-30), 0.0) for n, x in zip(noise, (u, v), strict=True)]
    if min(share) < CLEAR_SHARE:
        return 1.0
    return _correlation(u, v) / float(np.sqrt(share[0] * share[1]))


def _axes(
    press: Pressing, u: Float[np.ndarray, "m 3"], v: Float[np.ndarray, "m 3"], *, frames: int
) -> Float[np.ndarray, "3 3"]:
    """Correlations over markers of the components' means over some frames; 0 where noise hides one."""
    if len(u) < FEWEST_OVER_MARKERS:
        return np.eye(3)
    u, v = u - u.mean(axis=0), v - v.mean(axis=0)
    su, sv = u.std(axis=0), v.std(axis=0)
    seen_u, seen_v = (
        x > SEEN_SD * mean_sd(sd, frames) for x, sd in ((su, press.felt_sd_mm), (sv, press.gel_sd_mm))
    )
    both = v.T @ u / len(u) / np.maximum(sv[:, None] * su[None], 1e-30)
    return np.asarray(np.where(seen_v[:, None] & seen_u[None], both, 0.0))


def _lag(U: Float[np.ndarray, " t"], V: Float[np.ndarray, " t"]) -> tuple[int, float]:
    """Frames by which V follows U best, and the correlation there."""
    most = max(1, min(len(U) // LAG_SHARE, MOST_LAG))
    correlations = {}
    for lag in range(-most, most + 1):
        a = U[max(0, -lag) : len(U) - max(0, lag)]
        b = V[max(0, lag) : len(V) - max(0, -lag)]
        correlations[lag] = _correlation(a, b)
    best = max(correlations, key=lambda lag: correlations[lag])
    return best, correlations[best]


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


def axis_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Fields that are greatest along another axis than the one that is pressed.

    Friction carries no more than about the normal force, so that stiffness times displacement, and force, are
    greatest along z on the mean over a contact, whatever is sheared.
    """
    return shared([finding for press in pressings if press.touched.any() for finding in _axes_of_pad(press)])


def _axes_of_pad(press: Pressing) -> Iterator[Finding]:
    top, pad = heaviest(press), press.pad
    stiffness = np.array([pad.gel_kt_MPa_per_mm, pad.gel_kt_MPa_per_mm, pad.gel_kn_MPa_per_mm])
    fields: dict[Field, np.ndarray] = {"force": press.force_N}
    if gives_way(press):
        fields["displacement"] = press.felt_mm * stiffness
    for name, values in fields.items():
        mean = np.abs(values[top][:, press.touched].mean(axis=(0, 1)))
        most = int(np.argmax(mean))
        noise = float(np.sqrt((values[press.quiet] ** 2).mean() / press.touched.sum()))
        if most != 2 and mean[most] > max(NOT_FRICTION * mean[2], OVER_NOISE * noise):
            says = (
                f"{name} has its axes exchanged or rotated: it is largest along {AXES[most]}, expected along "
                "z, out of the gel"
            )
            yield _refused(press, FindingKind.AXES, says, field=name)


def relation_findings(
    pressings: Sequence[Pressing], *, closing_mm: Sequence[float], E_range_MPa: tuple[float, float] | None
) -> list[Finding]:
    """What the gel's law says of every pad; causes that both pads share are said once.

    `closing_mm`: how far each pad goes past its first touch; `E_range_MPa`: what flesh of the category can
    have. The two say which of force, displacement and stated stiffness is wrong where a gain is.
    """
    findings: list[Finding] = []
    gains: list[tuple[Pressing, float, float]] = []
    for press, closing in zip(pressings, closing_mm, strict=True):
        relation = relation_of(press)
        if relation is None:
            continue
        if (finding := _pad_finding(press, relation)) is not None:
            findings.append(finding)
        elif abs(np.log(max(relation.gain, 1e-12))) > GAIN_SAID:
            gains.append((press, relation.gain, closing))
    return [*shared(findings), *gain_findings(gains, pads=len(pressings), E_range_MPa=E_range_MPa)]


def _pad_finding(press: Pressing, r: Relation) -> Finding | None:
    """Everything but a gain: the first mistake, the plainest first, that the relation shows."""
    findings = (
        _refused(press, kind, says, **more) for shown, kind, says, more in _mistakes(press, r) if shown
    )
    return next(findings, None)


def _mistakes(press: Pressing, r: Relation) -> Iterator[tuple[bool, FindingKind, str, dict[str, Any]]]:
    """Whether each mistake shows, its kind, what is said of it, and what else the finding holds."""
    force_N, moved_mm = peak_total_N(press), peak_normal(press.felt_mm)
    yield (
        r.felt_mm < DEAD * r.gel_mm and _flat(press.felt_mm, press.felt_sd_mm, press.touched),
        FindingKind.DEAD_FIELD,
        f"displacement is dead: it stays at {1e3 * moved_mm:.0f} um while its forces reach {force_N:.2g} "
        "N, so tracking failed",
        {"field": "displacement"},
    )
    yield (
        r.gel_mm < DEAD * r.felt_mm and _flat(press.force_N, press.force_sd_N, press.touched),
        FindingKind.DEAD_FIELD,
        f"force is dead: it stays at {force_N:.2g} N while its markers move {moved_mm:.2f} mm",
        {"field": "force"},
    )
    along, followed = (AXES[axis] for axis in _exchanged(r) or (2, 2))
    field = _field_exchanged(press)
    yield (
        along != followed,
        FindingKind.AXES,
        f"{field or 'force or displacement'} has its axes exchanged or rotated: the force along {along} "
        f"follows the displacement along {followed}",
        {"field": field},
    )
    wrong: Field = "displacement" if _pushes(press) else "force"
    yield (
        r.in_time < -IN_STEP,
        FindingKind.SIGN,
        f"{wrong} has the wrong sign: pressing must move markers to negative z and give a positive force "
        "on the fruit",
        {"field": wrong},
    )
    apart = r.in_time < OUT_OF_STEP
    yield (
        apart and r.lag_frames != 0 and r.at_lag > max(IN_STEP, r.in_time + LAG_BETTER),
        FindingKind.DELAY,
        f"force comes {abs(r.lag_frames)} frames {'late' if r.lag_frames > 0 else 'early'} relative to "
        "its displacement: the two clocks disagree",
        {"detail": f"{r.lag_frames} frames"},
    )
    yield (
        apart and r.summed > IN_STEP,
        FindingKind.INCREMENTS,
        "displacement is written as increments between frames: its cumulative sum follows the force. "
        "Write displacement from rest",
        {},
    )
    yield (
        apart,
        FindingKind.OUT_OF_STEP,
        f"force and displacement do not agree over time (correlation {r.in_time:.2f}, expected above 0.97): "
        "frames of one of them are shuffled, missing or wrong",
        {"detail": f"{r.in_time:.2f}"},
    )
    correlation = f"{max(r.over_markers, 0):.2f}"
    yield (
        r.over_markers < SAME_MARKERS,
        FindingKind.OTHER_MARKERS,
        f"force and displacement do not belong to the same markers (correlation over markers {correlation}, "
        "expected above 0.9): one of them has another marker order (permuted)",
        {"detail": correlation},
    )
    yield (
        r.saturation < SATURATES,
        FindingKind.SATURATION,
        f"force is clipped: it grows {r.saturation:.1f} times as fast above half its peak as below; the "
        "sensor saturates or is nonlinear (run drupe explain for the amount)",
        {"field": "force", "has_effect": True},
    )
    yield (
        r.saturation > 1 / SATURATES,
        FindingKind.SATURATION,
        f"displacement is clipped: it grows {1 / r.saturation:.1f} times as fast above half its peak as "
        "below; tracking saturates",
        {"field": "displacement"},
    )


def _refused(press: Pressing, kind: FindingKind, says: str, **more: Any) -> Finding:
    """A finding of one pad that makes its recording unusable."""
    return Finding(kind, FindingRank.RELATION, says, pads=(press.pad.name,), refused=True, **more)


def _exchanged(r: Relation) -> tuple[int, int] | None:
    """The axes (force, displacement) that go together although they differ."""
    axes = np.abs(r.axes)
    for j in (0, 1):
        if max(axes[2, j], axes[j, 2]) > max(ON_ANOTHER_AXIS, axes[2, 2] + BETTER):
            return (2, j) if axes[2, j] >= axes[j, 2] else (j, 2)
    if min(axes[0, 1], axes[1, 0]) > IN_PLANE[0] and max(axes[0, 0], axes[1, 1]) < IN_PLANE[1]:
        return 0, 1
    return None


def _field_exchanged(press: Pressing) -> Field | None:
    """Whichever has its largest component elsewhere than along z; None where neither has."""
    fields: dict[Field, np.ndarray] = {"displacement": press.felt_mm, "force": press.force_N}
    for name, values in fields.items():
        if int(np.argmax((values[press.pressed] ** 2).sum(axis=0))) != 2:
            return name
    return None


def _flat(values: Float[np.ndarray, "t n 3"], sd: float, use: Bool[np.ndarray, " n"]) -> bool:
    """Whether nothing of a field rises above its noise."""
    return bool(np.sqrt((values[:, use] ** 2).mean(axis=(1, 2))).max() < max(FLAT_SD * sd, 1e-9))


def _pushes(press: Pressing) -> bool:
    total = press.force_N[:, :, 2].sum(axis=1)
    return bool(total.max() > -total.min())
