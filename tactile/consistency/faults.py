"""Values that no sensor gives: markers that are dead, frozen or clipped, frames of zeros, copied frames."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from tactile.consistency.finding import MEANINGLESS, Field, Finding, FindingKind, doubted
from tactile.consistency.pressing import Pressing, at_peak, gives_way, noise_shares

LOST_SAID, LOST_REFUSED, E_PER_LOST = 0.01, 0.05, 2.0
"""Share of a contact's markers or values that are lost, from which it is said, and refused; E loses 0.8 to
1.0 of it: 30 % of the markers 27 to 28 %, a force clipped at half, which is 0.41 of the values, 34 %.
Doubled, since what went is not known."""
DEAD = 0.02
"""Total of a dead field over what the other one says; sound fields have 0.94 to 1.06."""
FROZEN_FRAMES, FROZEN_SHARE, AROUND = 3, 0.25, 0.75
"""A marker is dead that repeats itself exactly in so many frames, and in this share of those in which AROUND
of its neighbours are pressed and most markers change: noise of 4 um in steps of 0.1 um does so once in
1e5."""
FAINT, OF_PEAK, FAINT_SD = 0.25, 0.5, 8.0
"""So is one that carries less than this share of its neighbours' median where that is half the peak, and
beyond so many standard deviations of noise; within sound contacts no marker there has less than 0.6."""
FEWEST_LEVELS, CLIPPED_SAMPLES = 12, 12
"""Different values of a field below which its steps repeat values; samples that share a field's greatest
value exactly: sound recordings have one to three (benchmarks/field_spreads.py)."""
NOISE: dict[Field, float] = {"displacement": 0.057, "force": 0.27}
"""Noise over what the most pressed markers show; sound recordings have up to 0.0545 and 0.249,
on soft gels (benchmarks/field_spreads.py)."""
NOISE_REFUSED = 0.1
"""Of the displacement, from which it is refused."""
E_PER_NOISE = (6.0, 1.0)
"""Relative error of E per share of noise in displacement and force: a first touch is found late. 0.08 of the
displacement made E 47 % too small on one fruit (benchmarks/field_mistakes.py)."""


def value_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """What is wrong with single markers, values and frames, pad by pad."""
    findings: list[Finding] = []
    for press in pressings:
        if dead := list(_dead_field(press)):
            findings += dead
            continue
        findings += _clipped(press)
        fields = (press.pad.displacement_mm, press.pad.force_N)
        if not press.pressed.any() or all(len(np.unique(f[:, :, 2])) >= FEWEST_LEVELS for f in fields):
            findings += [*_whole_frames(press), *_markers(press)]
    return findings


def _finding(press: Pressing, kind: FindingKind, says: str, relative_sd: float, **more: Any) -> Finding:
    return doubted(kind, says, relative_sd=relative_sd, pads=(press.pad.name,), **more)


def lost_finding(press: Pressing, kind: FindingKind, says: str, share: float, **more: Any) -> Finding:
    """The finding that this share of a contact's markers or values is lost."""
    pads, refused = (press.pad.name,), share > LOST_REFUSED
    return Finding(kind, says, pads=pads, relative_sd=E_PER_LOST * share, refused=refused, **more)


def noise_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Signals that hardly rise above their noise."""
    findings = []
    for press in pressings:
        shares = noise_shares(press)
        for (name, most), share in zip(NOISE.items(), shares, strict=True):
            if share > most and press.pressed.any() and (name == "force" or gives_way(press)):
                says = (
                    f"{name} is mostly noise: {100 * share:.0f} % of the signal of the most loaded markers, "
                    f"expected below {100 * most:.0f} %; press harder, or check the sensor"
                )
                refused, sd = shares[0] > NOISE_REFUSED, float(np.dot(E_PER_NOISE, shares))
                kind, pads = FindingKind.NOISE, (press.pad.name,)
                more: dict[str, Any] = {"field": name, "refused": refused, "hides_touch": True}
                findings.append(Finding(kind, says, pads=pads, relative_sd=sd, **more))
                break
    return findings


def _dead_field(press: Pressing) -> Iterator[Finding]:
    """A field in which nothing rises above noise while the other says that it should."""
    use = press.touched
    if press.gel_mm is None or not use.any():
        return
    totals = [float(np.abs(field[:, use, 2].sum(axis=1)).max()) for field in (press.felt_mm, press.gel_mm)]
    fields: tuple[tuple[Field, np.ndarray, float], ...] = (
        ("displacement", press.felt_mm, press.felt_sd_mm),
        ("force", press.force_N, press.force_sd_N),
    )
    for k, (name, values, noise) in enumerate(fields):
        size = float(np.sqrt((values[:, use] ** 2).mean(axis=(1, 2))).max())
        if size < max(2 * noise, 1e-9) and totals[k] < DEAD * totals[1 - k]:
            says = (
                f"{name} is dead: it does not rise above its noise while the other field does, so the sensor "
                "or its tracking failed; record the grasp again"
            )
            yield _finding(press, FindingKind.DEAD_FIELD, says, MEANINGLESS, field=name)


def dead_markers(press: Pressing) -> Bool[np.ndarray, " n"]:
    """Markers in the contact that give nothing, or nothing new."""
    asked_where = press.pressed[:, press.near].mean(axis=2) >= (AROUND if press.felt_sd_mm == 0 else 0.5)
    dead = np.zeros(len(press.touched), dtype=bool)
    for values in (press.pad.displacement_mm, press.pad.force_N):
        repeats = (values[1:] == values[:-1]).all(axis=2)
        asked = asked_where[1:] & (repeats.mean(axis=1) < 0.5)[:, None]
        same = (repeats & asked).sum(axis=0)
        dead |= (same >= FROZEN_FRAMES) & (same >= FROZEN_SHARE * asked.sum(axis=0))
        mean, sd = at_peak(press, values - np.median(values[press.quiet], axis=0))
        size = np.abs(mean[:, 2])
        around = np.median(size[press.near], axis=1)
        smooth = np.corrcoef(size, around)[0, 1] > 0.3 if size.std() * around.std() > 0 else False
        if smooth:  # else they are in chance order
            strong = around > max(OF_PEAK * float(np.quantile(size, 0.99)), FAINT_SD * sd)
            dead |= strong & (size < FAINT * around)
    return dead


def _markers(press: Pressing) -> Iterator[Finding]:
    dead = dead_markers(press)
    contact = press.touched | dead
    share = float(dead.sum() / max(contact.sum(), 1))
    if share > LOST_SAID:
        says = (
            f"markers are dead: {int(dead.sum())} of the {int(contact.sum())} in the contact "
            f"({100 * share:.0f} %) are zero or frozen. Their force is missing; clean or replace the gel"
        )
        yield lost_finding(press, FindingKind.DEAD_MARKERS, says, share)


def _whole_frames(press: Pressing) -> Iterator[Finding]:
    """Frames that are all zero in a field that has noise, and frames copied from the one before."""
    fields: dict[Field, np.ndarray] = {"displacement": press.pad.displacement_mm, "force": press.pad.force_N}
    pressed = np.asarray(press.pressed.any(axis=1))
    adjacent = np.zeros_like(pressed)
    adjacent[1:-1] = pressed[:-2] | pressed[2:]
    for (name, values), noise in zip(fields.items(), (press.felt_sd_mm, press.force_sd_N), strict=True):
        lost = np.asarray((values == 0).all(axis=(1, 2))) & adjacent
        if noise > 0 and lost.any():
            says = (
                f"{name} is zero at every marker in {int(lost.sum())} frames during the contact (first: "
                f"frame {int(np.argmax(lost))}), so frames are missing and filled with zeros"
            )
            yield _finding(press, FindingKind.ZERO_FRAMES, says, MEANINGLESS, field=name)
    copied = pressed[1:] & np.all([(v[1:] == v[:-1]).all(axis=(1, 2)) for v in fields.values()], axis=0)
    if press.felt_sd_mm > 0 and copied.sum() > 1:
        says = (
            f"frames are duplicated: {int(copied.sum())} in the contact repeat the frame before (first: "
            f"frame {int(np.argmax(copied)) + 1}); E loses no value, but only their time"
        )
        yield Finding(FindingKind.COPIED_FRAMES, says, pads=(press.pad.name,), remark=True)


def _clipped(press: Pressing) -> Iterator[Finding]:
    """Fields whose greatest value repeats, more often than a quarter of the values just below it."""
    for name, values in (("displacement", press.pad.displacement_mm), ("force", press.pad.force_N)):
        normal = np.abs(values[:, :, 2])
        top = float(normal.max())
        clipped = normal >= top * (1 - 1e-6)
        below = (normal > 0.95 * top) & ~clipped
        many = len(np.unique(normal)) >= FEWEST_LEVELS and clipped.sum() >= CLIPPED_SAMPLES
        if top > 0 and press.pressed.any() and many and clipped.sum() > 0.25 * below.sum():
            share = float(clipped.sum() / press.pressed.sum())
            says = (
                f"{name} is clipped: {int(clipped.sum())} values are exactly {top:.3g} "
                f"{'mm' if name == 'displacement' else 'N'}, the maximum; the sensor saturates, so press less"
            )
            yield lost_finding(press, FindingKind.CLIPPED, says, share, field=name)
