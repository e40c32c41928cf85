"""Forces that are not what the gel's stiffness says at its displacement: a unit, a scale, a gain."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from tactile.checks.finding import (
    FORCE,
    LENGTH,
    Field,
    Finding,
    FindingKind,
    FindingRank,
    times_said,
    unit_like,
)
from tactile.checks.lattice import is_thinned
from tactile.checks.pressing import Pressing, peak_normal, peak_total_N

GAIN_SAID, GAIN_REFUSED = 0.08, 0.4
"""|ln(V / U)| beyond which a gain is said, and refused; sound recordings have 0.03 and less, on fruit drawn
without a solver, of the noisiest, one of 400 pads 0.061 (benchmarks/field_spreads.py --cheap 100). The
mildest gain fault of the open cases (1.13) has 0.12, a nonlinear sensor 0.22."""
ONE_GAIN = 0.15
"""Difference of two pads' ln gains up to which they are said as one; a gain of one pad alone has more."""
STIFFNESS = {1e3: "kPa/mm (or MPa/m)", 1e6: "Pa/mm", 1e-3: "GPa/mm"}
"""What a number in MPa/mm becomes in another unit, times."""
E_PER_GAIN = 0.7
"""Relative error of E per ln gain; 1.14 on one pad of two makes 7 %, displacement halved on both 21 %."""
MOST_LEFT_OUT = 4
"""Every second, third or fourth marker kept; of fewer no contact of a fruit is left to find."""
LEAST_IN_GEL, MOST_IN_GEL = 0.005, 1.3
"""Gel's indentation over the pad's closing since first touch; sound recordings have 0.05 to 0.55
(benchmarks/field_spreads.py)."""
NU, RADIUS_MM, HERTZ_OFF = 0.45, 25.0, 2.0
"""For the modulus of a half-space under a ball, which is right to a factor of two for any fruit here."""


def unseen_error(measured: float, measured_sd: float, *, prior_sd: float) -> float:
    """Root mean square of an error e ~ N(0, prior_sd^2) that was measured as N(e, measured_sd^2).

    With w = prior_sd^2 / (prior_sd^2 + measured_sd^2) the posterior is N(w measured, w measured_sd^2), and e
    stays in the number whole: sqrt((w measured)^2 + w measured_sd^2).

    >>> round(unseen_error(0.0, 0.03, prior_sd=0.04), 4), round(unseen_error(0.08, 0.0, prior_sd=0.04), 4)
    (0.024, 0.08)
    """
    if prior_sd == 0.0:
        return 0.0
    w = prior_sd**2 / (prior_sd**2 + measured_sd**2)
    return float(np.sqrt((w * measured) ** 2 + w * measured_sd**2))


def gain_findings(
    gains: Sequence[tuple[Pressing, float, float]], *, pads: int, E_range_MPa: tuple[float, float] | None
) -> list[Finding]:
    """Gains of pads, with how far each closes (mm), said once for both where they agree."""
    said: list[tuple[Pressing, float, float, tuple[str, ...], float]] = [
        (press, gain, closing, (press.pad.name,), 1 / pads) for press, gain, closing in gains
    ]
    if len(said) == 2 and abs(np.log(said[0][1] / said[1][1])) < ONE_GAIN:
        (press, first_gain, closing, name, _), (_, second_gain, _, other, _) = said
        said = [(press, float(np.sqrt(first_gain * second_gain)), closing, (*name, *other), 1.0)]
    return [_gain_finding(*arguments, E_range_MPa=E_range_MPa) for arguments in said]


def _gain_finding(
    press: Pressing,
    gain: float,
    closing_mm: float,
    names: tuple[str, ...],
    share: float,
    *,
    E_range_MPa: tuple[float, float] | None,
) -> Finding:
    """The finding for a pad whose force over displacement is `gain` times what its gel predicts."""
    size = abs(float(np.log(gain)))
    left_out = _left_out(gain)
    if left_out > 1 and is_thinned(press.pad.rest_mm[:, :2]):
        return _thinned_finding(press, gain, names, left_out)
    blamed = _blamed(press, closing_mm, gain, E_range_MPa)
    said = f"{times_said(gain)} the value from this gel's stiffness and displacement"
    scaled = f"{times_said(1 / gain)} the value from this gel's stiffness and force"
    unit_F = unit_like(gain, FORCE)
    unit_u, unit_k = unit_like(1 / gain, LENGTH), unit_like(1 / gain, STIFFNESS)
    detail = ""
    if blamed == "displacement" and unit_u:
        kind, detail = FindingKind.DISPLACEMENT_UNIT, unit_u
        says = f"displacement looks like {unit_u}: {scaled}; record millimetres, or convert it"
    elif blamed == "displacement":
        kind = FindingKind.DISPLACEMENT_SCALE
        says = f"displacement is scaled: {scaled}, and does not match the closing of the jaws"
    elif blamed == "force" and unit_F:
        kind, detail = FindingKind.FORCE_UNIT, unit_F
        says = f"forces look like {unit_F}: {said}; record newtons, or convert force_N"
    elif blamed == "force":
        kind = FindingKind.FORCE_SCALE
        says = f"forces are scaled: {said}, and no fruit of this category has such a stiffness"
    elif unit_k and blamed == "stiffness":
        kind, detail = FindingKind.STIFFNESS_UNIT, unit_k
        says = f"gel_kn_MPa_per_mm looks like {unit_k}: forces are {said}, but agree with the fruit"
    elif unit_F and unit_k:
        kind, detail = FindingKind.FORCE_OR_STIFFNESS_UNIT, f"{unit_F} or {unit_k}"
        says = f"forces look like {unit_F}, or gel_kn_MPa_per_mm like {unit_k}: forces are {said}"
    else:
        kind = FindingKind.GAIN
        unit = f" (as if in {unit_F})" if unit_F else ""
        says = (
            f"forces are {said}{unit}. Possible causes are a gain of the force, a scale of the "
            "displacement, a creeping gel, or the stiffness (kn, kt) of another gel"
        )
        if left_out > 1:
            says += f"; or the arrays hold only one of every {left_out} markers"
    refused, sd = size > GAIN_REFUSED, E_PER_GAIN * size * share
    rank = FindingRank.RELATION
    return Finding(kind, rank, says, pads=names, detail=detail, refused=refused, relative_sd=sd)


def _left_out(gain: float) -> int:
    """How many markers there may be for each one in the arrays: each has the force of its own part of the
    gel, and the part of those that are left seems that much larger. 1 where the gain is no such fraction.
    """
    count = round(1 / gain) if gain > 0 else 1
    return count if 1 < count <= MOST_LEFT_OUT and abs(np.log(gain * count)) < GAIN_SAID else 1


def _thinned_finding(press: Pressing, gain: float, names: tuple[str, ...], count: int) -> Finding:
    """The finding that only every `count`-th marker of a pad is in the arrays."""
    there = len(press.pad.rest_mm)
    every = {2: "second", 3: "third", 4: "fourth"}[count]
    says = (
        f"markers are only every {every} one of the gel: about {(count - 1) * there} of {count * there} are "
        f"missing from the arrays. The remaining {there} form an uneven grid, and their forces are "
        f"{times_said(gain)} the value from the gel's stiffness. Write all markers"
    )
    kind, rank, sd = FindingKind.MARKERS_MISSING, FindingRank.RELATION, 1 - 1 / count
    return Finding(kind, rank, says, pads=names, detail=str(count), refused=True, relative_sd=sd)


def _blamed(
    press: Pressing, closing_mm: float, gain: float, E_range_MPa: tuple[float, float] | None
) -> Field | Literal["stiffness"] | None:
    """Force, displacement or stiffness, where only that one's being wrong suits the jaws and the fruit."""
    felt = peak_normal(press.felt_mm)
    if closing_mm > 0 and not LEAST_IN_GEL * closing_mm < felt < MOST_IN_GEL * closing_mm:
        return "displacement"
    if E_range_MPa is None or closing_mm <= 0:
        return None
    into_flesh = max(closing_mm - felt, 0.1 * closing_mm)
    E = 0.75 * (1 - NU**2) * peak_total_N(press) / (np.sqrt(RADIUS_MM) * into_flesh**1.5)
    low, high = E_range_MPa[0] / HERTZ_OFF, E_range_MPa[1] * HERTZ_OFF
    as_written, as_the_gel_says = low < E < high, low < E / gain < high
    if as_the_gel_says and not as_written:
        return "force"
    return "stiffness" if as_written and not as_the_gel_says else None
