"""Values that no sensor gives: markers that are dead, frozen or clipped, frames of zeros, copied frames."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactile.checks.finding import Field, Finding, FindingKind, FindingRank
from tactile.checks.pressing import (
    LOST_REFUSED,
    LOST_SAID,
    Pressing,
    gives_way,
    heaviest,
    like_neighbours,
    mean_sd,
    noise_shares,
)

FIELDS: tuple[Field, Field] = ("displacement", "force")
LIVELY, PRESSED_AROUND, PRESSED_WITHOUT_NOISE = 0.5, 0.5, 0.75
"""A frame tells frozen markers where more than this share of all markers differ from the frame before; a
marker is asked where half of its four neighbours are pressed. Without noise the zeros of a marker beside a
patch repeat exactly too, and two of its neighbours may be pressed: there three must be."""
FROZEN_FRAMES, FROZEN_SHARE = 3, 0.25
"""A marker counts as dead where it repeats itself exactly in so many frames, and in this share of those, in
which it is asked. A marker with noise of 4 um in steps of 0.1 um does so by chance
once in 1e5 frames."""
FAINT, OF_PEAK, FAINT_SD = 0.25, 0.5, 8.0
"""So does one that carries less than this share of its neighbours' median where that is half the peak, and
beyond so many standard deviations of noise; within sound contacts no marker there has less than 0.6."""
SIMILAR = 0.3
"""Correlation with neighbours below which a field's markers are in chance order, and none is called faint;
sound fields have 0.93 and more (benchmarks/field_spreads.py)."""
NOISE = (0.057, 0.27)
"""Noise over what the most pressed markers show, of displacement and of force. Sound ones have up to 0.032
and 0.079 on the even half of the fruit, up to 0.0545 and 0.249 on fruit drawn without a solver, whose gel
gives way by as little as 8 % of the closing (benchmarks/field_spreads.py, also with --cheap 100): 5 and 8 %
more are asked for. Ten times the noise of the even half makes 0.066 to 0.32 and 0.21 to 0.76."""
E_PER_NOISE = (6.0, 1.0)
"""Relative error of E per share of noise in displacement and force: a first touch is found late, when force
has left its noise by 4 standard deviations (tactile.contact), and what moved until then is lost. 0.08 of the
displacement made E 47 % too small on one fruit, which is of the half that benchmarks/field_mistakes.py
scores. The even half alone (--grade --only noise) gives no better number: of its two graded fruit one has E
7 % too large at 0.12, with its own error bar at ten times E, and the contact refuses the other. So this is a
bound from one fruit, no fit."""
NOISE_REFUSED = 0.1
"""Of the displacement: E_PER_NOISE makes 60 % of it, and E says nothing beyond."""
CLIPPED_SAMPLES, CLIPPED_BELOW, CLIPPED_OVER_BELOW = 12, 0.95, 0.25
"""Samples that share the field's greatest value exactly; sound recordings have one to three
(benchmarks/field_spreads.py). And over those between 95 % of it and it: steps would fill both alike."""
CLIPPED_REFUSED, E_PER_CLIPPED = 0.05, 2.0
"""Share of the pressed markers' values. A force clipped at 90 % of its peak has up to 0.045 of them and lost
0.7 % of the peak's total; at 80 % 0.09 and 2.5 to 4 %; at half 0.41 and 24 %, and E 34 % (even half of the
fruit of benchmarks/field_mistakes.py): 0.8 of the share, doubled, since what went is not known."""
COPIED_REFUSED = 0.3
"""Share of the contact's frames. Every second frame a copy makes up to 0.5, and copies up to a third leave
two new frames of three; E loses no value of them, only their time (benchmarks/results/field_mistakes.csv)."""
FEWEST_COPIED = 2
"""One copied frame may be the machine waiting for a trigger."""
FEWEST_LEVELS, LEVELS_REFUSED = 12, 4
"""Different values of a field between zero and its greatest: below the first its steps and not its noise
rule, and below the second steps are a quarter of the peak. Six steps left E 0.7 % off (--grade --only
steps)."""


def channel_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """What is wrong with single markers, values and frames, pad by pad."""
    findings: list[Finding] = []
    for press in pressings:
        findings += _values(press)
        levels = [_levels(normal) for normal in _normals(press).values()]
        if not press.pressed.any() or not any(0 < count < FEWEST_LEVELS for count in levels):
            # values in coarse steps repeat themselves
            findings += [*_whole_frames(press), *_markers(press)]
    return findings


def _finding(press: Pressing, kind: FindingKind, says: str, **more: Any) -> Finding:
    return Finding(kind, FindingRank.FIELD, says, pads=(press.pad.name,), **more)


def _normals(press: Pressing) -> dict[Field, Float[np.ndarray, "t n"]]:
    """Size of the normal parts as they were written, by field."""
    return {
        "displacement": np.abs(press.pad.displacement_mm[:, :, 2]),
        "force": np.abs(press.pad.force_N[:, :, 2]),
    }


def _levels(normal: Float[np.ndarray, "t n"]) -> int:
    """Different values of a field; 0 of one that is zero throughout."""
    return len(np.unique(normal)) if normal.any() else 0


def noise_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Signals that hardly rise above their noise."""
    return [finding for press in pressings if (finding := _noise(press)) is not None]


def _noise(press: Pressing) -> Finding | None:
    for name, share, most in zip(FIELDS, noise_shares(press), NOISE, strict=True):
        if share > most and press.pressed.any() and (name == "force" or gives_way(press)):
            says = (
                f"{name} is mostly noise: {100 * share:.0f} % of the signal of the most loaded markers, "
                f"expected below {100 * most:.0f} %; press harder, or check the sensor"
            )
            refused = name == "displacement" and share > NOISE_REFUSED
            spread = {"relative_sd": float(np.dot(E_PER_NOISE, noise_shares(press))), "hides_touch": True}
            return _finding(press, FindingKind.NOISE, says, field=name, refused=refused, **spread)
    return None


def dead_markers(press: Pressing) -> tuple[Bool[np.ndarray, " n"], str]:
    """Markers in the contact that give nothing, or nothing new, and in which words."""
    fields = {"displacement": press.pad.displacement_mm, "force": press.pad.force_N}
    least = PRESSED_AROUND if press.felt_sd_mm > 0 else PRESSED_WITHOUT_NOISE
    around = press.pressed[:, press.near].mean(axis=2) >= least
    dead, words = np.zeros(len(press.touched), dtype=bool), []
    for name, values in fields.items():
        repeats = (values[1:] == values[:-1]).all(axis=2)
        lively = repeats.mean(axis=1) < LIVELY
        asked = around[1:] & lively[:, None]
        same = repeats & asked
        frozen = (same.sum(axis=0) >= FROZEN_FRAMES) & (same.sum(axis=0) >= FROZEN_SHARE * asked.sum(axis=0))
        similar = like_neighbours(press, values)
        faint = _faint(press, values) if similar is not None and similar > SIMILAR else np.zeros_like(dead)
        if frozen.any():
            zero = not np.any(values[1:][same & frozen])
            words.append(("zero" if zero else "frozen", name))
        elif faint.any():
            words.append(("dead", name))
        dead |= frozen | faint
    if not words:
        return dead, ""
    what = words[0][0]
    return dead, f"{what} in {' and '.join(dict.fromkeys(name for _, name in words))}"


def _faint(press: Pressing, values: Float[np.ndarray, "t n 3"]) -> Bool[np.ndarray, " n"]:
    top = heaviest(press)
    mean = np.abs(values[top, :, 2].mean(axis=0) - np.median(values[press.quiet, :, 2], axis=0))
    sd = mean_sd(float(values[press.quiet].std()), len(top))
    around = np.median(mean[press.near], axis=1)
    peak = float(np.quantile(mean, 0.99))
    return np.asarray((around > max(OF_PEAK * peak, FAINT_SD * sd)) & (mean < FAINT * around))


def _markers(press: Pressing) -> Iterator[Finding]:
    """A finding where more than LOST_SAID of the contact's markers are dead; refused above LOST_REFUSED."""
    dead, words = dead_markers(press)
    contact = press.touched | dead
    share = float(dead.sum() / max(contact.sum(), 1))
    if share > LOST_SAID:
        says = (
            f"markers are dead: {int(dead.sum())} of the {int(contact.sum())} in the contact "
            f"({100 * share:.0f} %) are {words} while their neighbours carry load, so their force is missing"
        )
        refused = share > LOST_REFUSED
        yield _finding(press, FindingKind.DEAD_MARKERS, says, refused=refused, relative_sd=share)


def _whole_frames(press: Pressing) -> Iterator[Finding]:
    """Frames that are all zero in a field that has noise, and frames copied from the one before."""
    fields = press.pad.displacement_mm, press.pad.force_N
    pressed = np.asarray(press.pressed.any(axis=1))
    adjacent = np.zeros_like(pressed)
    adjacent[1:-1] = pressed[:-2] | pressed[2:]
    for name, values, noise in zip(FIELDS, fields, (press.felt_sd_mm, press.force_sd_N), strict=True):
        zero = np.asarray((values == 0).all(axis=(1, 2)))
        lost = zero & adjacent
        if noise > 0 and lost.any() and not zero.all():
            says = (
                f"{name} is zero at every marker in {int(lost.sum())} frames during the contact (first: "
                f"frame {int(np.argmax(lost))}), so frames are missing and filled with zeros"
            )
            yield _finding(press, FindingKind.ZERO_FRAMES, says, field=name, refused=True)
    copied = pressed[1:] & np.all([(values[1:] == values[:-1]).all(axis=(1, 2)) for values in fields], axis=0)
    if press.felt_sd_mm > 0 and copied.sum() >= FEWEST_COPIED:
        says = (
            f"frames are duplicated: {int(copied.sum())} in the contact repeat the frame before (first: "
            f"frame {int(np.argmax(copied)) + 1})"
        )
        share = float(copied.mean())
        refused = share > COPIED_REFUSED
        yield _finding(press, FindingKind.COPIED_FRAMES, says, refused=refused, relative_sd=share)


def _values(press: Pressing) -> Iterator[Finding]:
    """Fields whose greatest value repeats, or that know few values."""
    for name, normal in _normals(press).items():
        top, levels = float(normal.max()), _levels(normal)
        if top <= 0 or not press.pressed.any():
            continue
        clipped = normal >= top * (1 - 1e-6)
        below = (normal > CLIPPED_BELOW * top) & ~clipped
        if levels < FEWEST_LEVELS:
            says = (
                f"{name} has only {levels} different values up to {top:.3g}, so its quantisation is "
                "too coarse"
            )
            effect = {"refused": levels < LEVELS_REFUSED, "relative_sd": 1.0 / levels}
            yield _finding(press, FindingKind.COARSE_STEPS, says, field=name, **effect)
        elif clipped.sum() >= CLIPPED_SAMPLES and clipped.sum() > CLIPPED_OVER_BELOW * below.sum():
            share = float(clipped.sum() / max(press.pressed.sum(), 1))
            says = (
                f"{name} is clipped: {int(clipped.sum())} values are exactly {top:.3g} "
                f"{'mm' if name == 'displacement' else 'N'}, the maximum; the sensor saturates"
            )
            effect = {"refused": share > CLIPPED_REFUSED, "relative_sd": E_PER_CLIPPED * share}
            yield _finding(press, FindingKind.CLIPPED, says, field=name, **effect)
