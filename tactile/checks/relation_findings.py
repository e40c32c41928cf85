"""What is wrong where a gel's force and displacement do not agree: unit, sign, axes, delay, order, gain.

The numbers are tactile/checks/relation.py's: with U the displacement felt and V the one that the forces make
by the gel's law, V = U but for noise. Numbers that sound recordings show stand beside each limit
(`benchmarks/field_spreads.py`).
"""

from collections.abc import Iterator, Sequence
from typing import Any

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
    return shared([finding for press in pressings if press.touched.any() for finding in _axes(press)])


def _axes(press: Pressing) -> Iterator[Finding]:
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
    gains: list[tuple[Pressing, Relation, float]] = []
    for press, closing in zip(pressings, closing_mm, strict=True):
        relation = relation_of(press)
        if relation is None:
            continue
        if (finding := _pad_finding(press, relation)) is not None:
            findings.append(finding)
        elif abs(np.log(max(relation.gain, 1e-12))) > GAIN_SAID:
            gains.append((press, relation, closing))
    return [*shared(findings), *gain_findings(gains, pads=len(pressings), E_range_MPa=E_range_MPa)]


def _pad_finding(press: Pressing, r: Relation) -> Finding | None:
    """Everything but a gain, the plainest cause first."""
    causes = (_dead_finding, _axes_finding, _timing_finding, _markers_finding, _clipped_finding)
    return next((finding for cause in causes if (finding := cause(press, r)) is not None), None)


def _dead_finding(press: Pressing, r: Relation) -> Finding | None:
    """One of the two stays where it is while the other changes."""
    force_N, moved_mm = peak_total_N(press), peak_normal(press.felt_mm)
    if r.felt_mm < DEAD * r.gel_mm and _flat(press.felt_mm, press.felt_sd_mm, press.touched):
        says = (
            f"displacement is dead: it stays at {1e3 * moved_mm:.0f} um while its forces reach {force_N:.2g} "
            "N, so tracking failed"
        )
        return _refused(press, FindingKind.DEAD_FIELD, says, field="displacement")
    if r.gel_mm < DEAD * r.felt_mm and _flat(press.force_N, press.force_sd_N, press.touched):
        says = f"force is dead: it stays at {force_N:.2g} N while its markers move {moved_mm:.2f} mm"
        return _refused(press, FindingKind.DEAD_FIELD, says, field="force")
    return None


def _axes_finding(press: Pressing, r: Relation) -> Finding | None:
    """Axes of one of the two are exchanged."""
    if (exchanged := _exchanged(r)) is None:
        return None
    along, followed = (AXES[axis] for axis in exchanged)
    field = _field_exchanged(press)
    says = (
        f"{field or 'force or displacement'} has its axes exchanged or rotated: the force along {along} "
        f"follows the displacement along {followed}"
    )
    return _refused(press, FindingKind.AXES, says, field=field)


def _timing_finding(press: Pressing, r: Relation) -> Finding | None:
    """The two go against each other, or apart, over time."""
    if r.in_time < -IN_STEP:
        wrong: Field = "displacement" if _pushes(press) else "force"
        says = (
            f"{wrong} has the wrong sign: pressing must move markers to negative z and give a positive force "
            "on the fruit"
        )
        return _refused(press, FindingKind.SIGN, says, field=wrong)
    if r.in_time >= OUT_OF_STEP:
        return None
    if r.lag_frames and r.at_lag > max(IN_STEP, r.in_time + LAG_BETTER):
        says = (
            f"force comes {abs(r.lag_frames)} frames {'late' if r.lag_frames > 0 else 'early'} relative to "
            "its displacement: the two clocks disagree"
        )
        return _refused(press, FindingKind.DELAY, says, detail=f"{r.lag_frames} frames")
    if r.summed > IN_STEP:
        says = (
            "displacement is written as increments between frames: its cumulative sum follows the force. "
            "Write displacement from rest"
        )
        return _refused(press, FindingKind.INCREMENTS, says)
    says = (
        f"force and displacement do not agree over time (correlation {r.in_time:.2f}, expected above 0.97): "
        "frames of one of them are shuffled, missing or wrong"
    )
    return _refused(press, FindingKind.OUT_OF_STEP, says, detail=f"{r.in_time:.2f}")


def _markers_finding(press: Pressing, r: Relation) -> Finding | None:
    """The two list their markers in different orders."""
    if r.over_markers >= SAME_MARKERS:
        return None
    correlation = f"{max(r.over_markers, 0):.2f}"
    says = (
        f"force and displacement do not belong to the same markers (correlation over markers {correlation}, "
        "expected above 0.9): one of them has another marker order (permuted)"
    )
    return _refused(press, FindingKind.OTHER_MARKERS, says, detail=correlation)


def _clipped_finding(press: Pressing, r: Relation) -> Finding | None:
    """One of the two stops growing where the other goes on."""
    if r.saturation < SATURATES:
        says = (
            f"force is clipped: it grows {r.saturation:.1f} times as fast above half its peak as below; the "
            "sensor saturates or is nonlinear (run drupe explain for the amount)"
        )
        return _refused(press, FindingKind.SATURATION, says, field="force", has_effect=True)
    if r.saturation > 1 / SATURATES:
        says = (
            f"displacement is clipped: it grows {1 / r.saturation:.1f} times as fast above half its peak as "
            "below; tracking saturates"
        )
        return _refused(press, FindingKind.SATURATION, says, field="displacement")
    return None


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
