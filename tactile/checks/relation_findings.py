"""What is wrong where a gel's force and displacement do not agree: unit, sign, axes, delay, order, gain.

The numbers are tactile/checks/relation.py's: with U the displacement felt and V the one that the forces make
by the gel's law, V = U but for noise. Numbers that sound recordings show stand beside each limit
(`benchmarks/field_spreads.py`).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from tactile.checks.finding import Field, Finding, FindingKind, FindingRank, shared
from tactile.checks.gain_findings import GAIN_SAID, gain_findings
from tactile.checks.pressing import Pressing, gives_way, heaviest, peak_normal, peak_total_N
from tactile.checks.relation import Relation, relation_of

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


def axis_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Fields that are greatest along another axis than the one that is pressed.

    Friction carries no more than about the normal force, so that stiffness times displacement, and force, are
    greatest along z on the mean over a contact, whatever is sheared.
    """
    found = []
    for one in pressings:
        if not one.touched.any():
            continue
        top, pad = heaviest(one), one.pad
        stiffness = np.array([pad.gel_kt_MPa_per_mm, pad.gel_kt_MPa_per_mm, pad.gel_kn_MPa_per_mm])
        fields: dict[Field, np.ndarray] = {"force": one.force_N}
        if gives_way(one):
            fields["displacement"] = one.felt_mm * stiffness
        for name, values in fields.items():
            mean = np.abs(values[top][:, one.touched].mean(axis=(0, 1)))
            most = int(np.argmax(mean))
            noise = float(np.sqrt((values[one.quiet] ** 2).mean() / one.touched.sum()))
            if most != 2 and mean[most] > max(NOT_FRICTION * mean[2], OVER_NOISE * noise):
                found.append(
                    _refused(
                        one,
                        FindingKind.AXES,
                        f"{name} has its axes exchanged or rotated: it is largest along {AXES[most]}, "
                        "expected along z, out of the gel",
                        field=name,
                    )
                )
    return shared(found)


def relation_findings(
    pressings: Sequence[Pressing], *, closing_mm: Sequence[float], E_range_MPa: tuple[float, float] | None
) -> list[Finding]:
    """What the gel's law says of every pad; causes that both pads share are said once.

    `closing_mm`: how far each pad goes past its first touch; `E_range_MPa`: what flesh of the category can
    have. The two say which of force, displacement and stated stiffness is wrong where a gain is.
    """
    relations = [relation_of(one) for one in pressings]
    found: list[Finding] = []
    gains: list[tuple[Pressing, Relation, float]] = []
    for one, relation, closing in zip(pressings, relations, closing_mm, strict=True):
        if relation is None:
            continue
        own = _pad_finding(one, relation)
        if own is not None:
            found.append(own)
        elif abs(np.log(max(relation.gain, 1e-12))) > GAIN_SAID:
            gains.append((one, relation, closing))
    return [*shared(found), *gain_findings(gains, pads=len(pressings), E_range_MPa=E_range_MPa)]


def _pad_finding(one: Pressing, r: Relation) -> Finding | None:
    """Everything but a gain, the plainest cause first."""
    return (
        _dead_finding(one, r)
        or _axes_finding(one, r)
        or _timing_finding(one, r)
        or _markers_finding(one, r)
        or _clipped_finding(one, r)
    )


def _dead_finding(one: Pressing, r: Relation) -> Finding | None:
    """One of the two stays where it is while the other changes."""
    if r.felt_mm < DEAD * r.gel_mm and _flat(one.felt_mm, one.felt_sd_mm, one.touched):
        return _refused(
            one,
            FindingKind.DEAD_FIELD,
            f"displacement is dead: it stays at {1e3 * peak_normal(one.felt_mm):.0f} um while its "
            f"forces reach {peak_total_N(one):.2g} N, so tracking failed",
            field="displacement",
        )
    if r.gel_mm < DEAD * r.felt_mm and _flat(one.force_N, one.force_sd_N, one.touched):
        return _refused(
            one,
            FindingKind.DEAD_FIELD,
            f"force is dead: it stays at {peak_total_N(one):.2g} N while its markers move "
            f"{peak_normal(one.felt_mm):.2f} mm",
            field="force",
        )
    return None


def _axes_finding(one: Pressing, r: Relation) -> Finding | None:
    """Axes of one of the two are exchanged."""
    if (exchanged := _exchanged(r)) is None:
        return None
    i, j = exchanged
    field = _field_exchanged(one)
    return _refused(
        one,
        FindingKind.AXES,
        f"{field or 'force or displacement'} has its axes exchanged or rotated: the force along "
        f"{AXES[i]} follows the displacement along {AXES[j]}",
        field=field,
    )


def _timing_finding(one: Pressing, r: Relation) -> Finding | None:
    """The two go against each other, or apart, over time."""
    if r.in_time < -IN_STEP:
        wrong: Field = "displacement" if _pushes(one) else "force"
        return _refused(
            one,
            FindingKind.SIGN,
            f"{wrong} has the wrong sign: pressing must move markers to negative z and give a "
            "positive force on the fruit",
            field=wrong,
        )
    if r.in_time < OUT_OF_STEP and r.lag_frames and r.at_lag > max(IN_STEP, r.in_time + LAG_BETTER):
        late = "late" if r.lag_frames > 0 else "early"
        return _refused(
            one,
            FindingKind.DELAY,
            f"force comes {abs(r.lag_frames)} frames {late} relative to its displacement: the two "
            "clocks disagree",
            detail=f"{r.lag_frames} frames",
        )
    if r.in_time < OUT_OF_STEP and r.summed > IN_STEP:
        return _refused(
            one,
            FindingKind.INCREMENTS,
            "displacement is written as increments between frames: its cumulative sum follows the "
            "force. Write displacement from rest",
        )
    if r.in_time < OUT_OF_STEP:
        return _refused(
            one,
            FindingKind.OUT_OF_STEP,
            f"force and displacement do not agree over time (correlation {r.in_time:.2f}, expected "
            "above 0.97): frames of one of them are shuffled, missing or wrong",
            detail=f"{r.in_time:.2f}",
        )
    return None


def _markers_finding(one: Pressing, r: Relation) -> Finding | None:
    """The two list their markers in different orders."""
    if r.over_markers >= SAME_MARKERS:
        return None
    return _refused(
        one,
        FindingKind.OTHER_MARKERS,
        "force and displacement do not belong to the same markers (correlation over markers "
        f"{max(r.over_markers, 0):.2f}, expected above 0.9): one of them has another marker order "
        "(permuted)",
        detail=f"{max(r.over_markers, 0):.2f}",
    )


def _clipped_finding(one: Pressing, r: Relation) -> Finding | None:
    """One of the two stops growing where the other goes on."""
    if r.saturation < SATURATES:
        return _refused(
            one,
            FindingKind.SATURATION,
            f"force is clipped: it grows {r.saturation:.1f} times as fast above half its peak as "
            "below; the sensor saturates or is nonlinear (run drupe explain for the amount)",
            field="force",
            has_effect=True,
        )
    if r.saturation > 1 / SATURATES:
        return _refused(
            one,
            FindingKind.SATURATION,
            f"displacement is clipped: it grows {1 / r.saturation:.1f} times as fast above half its "
            "peak as below; tracking saturates",
            field="displacement",
        )
    return None


def _refused(
    one: Pressing,
    kind: FindingKind,
    says: str,
    *,
    field: Field | None = None,
    detail: str = "",
    has_effect: bool = False,
) -> Finding:
    """A finding of one pad that makes its recording unusable."""
    return Finding(
        kind=kind,
        rank=FindingRank.RELATION,
        pads=(one.pad.name,),
        says=says,
        field=field,
        detail=detail,
        refused=True,
        has_effect=has_effect,
    )


def _exchanged(r: Relation) -> tuple[int, int] | None:
    """The axes (force, displacement) that go together although they differ."""
    axes = np.abs(r.axes)
    for j in (0, 1):
        if max(axes[2, j], axes[j, 2]) > max(ON_ANOTHER_AXIS, axes[2, 2] + BETTER):
            return (2, j) if axes[2, j] >= axes[j, 2] else (j, 2)
    if min(axes[0, 1], axes[1, 0]) > IN_PLANE[0] and max(axes[0, 0], axes[1, 1]) < IN_PLANE[1]:
        return 0, 1
    return None


def _field_exchanged(one: Pressing) -> Field | None:
    """Whichever has its largest component elsewhere than along z; None where neither has."""
    fields: dict[Field, np.ndarray] = {"displacement": one.felt_mm, "force": one.force_N}
    for name, values in fields.items():
        if int(np.argmax((values[one.pressed] ** 2).sum(axis=0))) != 2:
            return name
    return None


def _flat(values: Float[np.ndarray, "t n 3"], sd: float, use: Bool[np.ndarray, " n"]) -> bool:
    """Whether nothing of a field rises above its noise."""
    return bool(np.sqrt((values[:, use] ** 2).mean(axis=(1, 2))).max() < max(FLAT_SD * sd, 1e-9))


def _pushes(one: Pressing) -> bool:
    total = one.force_N[:, :, 2].sum(axis=1)
    return bool(total.max() > -total.min())
