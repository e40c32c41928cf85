"""Values that no sensor gives: markers that are dead, frozen or clipped, frames of zeros, copied frames."""

from collections.abc import Sequence

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
    found: list[Finding] = []
    for one in pressings:
        found += _values(one)
        if one.pressed.any() and any(
            0 < _levels(normal) < FEWEST_LEVELS for normal in _normals(one).values()
        ):
            continue  # values in coarse steps repeat themselves
        found += _whole_frames(one)
        found += _markers(one)
    return found


def _normals(one: Pressing) -> dict[Field, Float[np.ndarray, "t n"]]:
    """Size of the normal parts as they were written, by field."""
    return {
        "displacement": np.abs(one.pad.displacement_mm[:, :, 2]),
        "force": np.abs(one.pad.force_N[:, :, 2]),
    }


def _levels(normal: Float[np.ndarray, "t n"]) -> int:
    """Different values of a field; 0 of one that is zero throughout."""
    return len(np.unique(normal)) if normal.any() else 0


def noise_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """Signals that hardly rise above their noise."""
    found = []
    for one in pressings:
        for name, share, most in zip(FIELDS, noise_shares(one), NOISE, strict=True):
            if name == "displacement" and not gives_way(one):
                continue
            if share > most and one.pressed.any():
                found.append(
                    Finding(
                        kind=FindingKind.NOISE,
                        rank=FindingRank.FIELD,
                        pads=(one.pad.name,),
                        field=name,
                        says=(
                            f"{name} is mostly noise: {100 * share:.0f} % of the signal of the most "
                            f"loaded markers, expected below {100 * most:.0f} %; press harder, or "
                            "check the sensor"
                        ),
                        refused=name == "displacement" and share > NOISE_REFUSED,
                        relative_sd=float(np.dot(E_PER_NOISE, noise_shares(one))),
                        hides_touch=True,
                    )
                )
                break
    return found


def dead_markers(one: Pressing) -> tuple[Bool[np.ndarray, " n"], str]:
    """Markers in the contact that give nothing, or nothing new, and in which words."""
    fields = {"displacement": one.pad.displacement_mm, "force": one.pad.force_N}
    least = PRESSED_AROUND if one.felt_sd_mm > 0 else PRESSED_WITHOUT_NOISE
    around = one.pressed[:, one.near].mean(axis=2) >= least
    dead, words = np.zeros(len(one.touched), dtype=bool), []
    for name, values in fields.items():
        repeats = (values[1:] == values[:-1]).all(axis=2)
        lively = repeats.mean(axis=1) < LIVELY
        asked = around[1:] & lively[:, None]
        same = repeats & asked
        frozen = (same.sum(axis=0) >= FROZEN_FRAMES) & (same.sum(axis=0) >= FROZEN_SHARE * asked.sum(axis=0))
        similar = like_neighbours(one, values)
        faint = _faint(one, values) if similar is not None and similar > SIMILAR else np.zeros_like(dead)
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


def _faint(one: Pressing, values: Float[np.ndarray, "t n 3"]) -> Bool[np.ndarray, " n"]:
    top = heaviest(one)
    mean = np.abs(values[top, :, 2].mean(axis=0) - np.median(values[one.quiet, :, 2], axis=0))
    sd = mean_sd(float(values[one.quiet].std()), len(top))
    around = np.median(mean[one.near], axis=1)
    peak = float(np.quantile(mean, 0.99))
    return np.asarray((around > max(OF_PEAK * peak, FAINT_SD * sd)) & (mean < FAINT * around))


def _markers(one: Pressing) -> list[Finding]:
    """A finding where more than LOST_SAID of the contact's markers are dead; refused above LOST_REFUSED."""
    dead, words = dead_markers(one)
    contact = one.touched | dead
    share = float(dead.sum() / max(contact.sum(), 1))
    if share <= LOST_SAID:
        return []
    return [
        Finding(
            kind=FindingKind.DEAD_MARKERS,
            rank=FindingRank.FIELD,
            pads=(one.pad.name,),
            says=(
                f"markers are dead: {int(dead.sum())} of the {int(contact.sum())} in the contact "
                f"({100 * share:.0f} %) are {words} while their neighbours carry load, so their force "
                "is missing"
            ),
            refused=share > LOST_REFUSED,
            relative_sd=share,
        )
    ]


def _whole_frames(one: Pressing) -> list[Finding]:
    """Frames that are all zero in a field that has noise, and frames copied from the one before."""
    found = []
    of_fields = (one.pad.displacement_mm, one.pad.force_N), (one.felt_sd_mm, one.force_sd_N)
    for name, values, noise in zip(FIELDS, *of_fields, strict=True):
        zero = np.asarray((values == 0).all(axis=(1, 2)))
        adjacent = np.zeros_like(zero)
        pressed = np.asarray(one.pressed.any(axis=1))
        adjacent[1:-1] = pressed[:-2] | pressed[2:]
        lost = np.asarray(zero & adjacent) if not zero.all() else np.zeros_like(zero)
        if noise > 0 and lost.any():
            found.append(
                Finding(
                    kind=FindingKind.ZERO_FRAMES,
                    rank=FindingRank.FIELD,
                    pads=(one.pad.name,),
                    field=name,
                    says=(
                        f"{name} is zero at every marker in {int(lost.sum())} frames during the "
                        f"contact (first: frame {int(np.argmax(lost))}), so frames are missing and "
                        "filled with zeros"
                    ),
                    refused=True,
                )
            )
    both = [(v[1:] == v[:-1]).all(axis=(1, 2)) for v in (one.pad.displacement_mm, one.pad.force_N)]
    copied = both[0] & both[1] & one.pressed[1:].any(axis=1)
    if one.felt_sd_mm > 0 and copied.sum() >= FEWEST_COPIED:
        found.append(
            Finding(
                kind=FindingKind.COPIED_FRAMES,
                rank=FindingRank.FIELD,
                pads=(one.pad.name,),
                says=(
                    f"frames are duplicated: {int(copied.sum())} in the contact repeat the frame "
                    f"before (first: frame {int(np.argmax(copied)) + 1})"
                ),
                refused=bool(copied.mean() > COPIED_REFUSED),
                relative_sd=float(copied.mean()),
            )
        )
    return found


def _values(one: Pressing) -> list[Finding]:
    """Fields whose greatest value repeats, or that know few values."""
    found = []
    for name, normal in _normals(one).items():
        top = float(normal.max())
        if top <= 0 or not one.pressed.any():
            continue
        levels = _levels(normal)
        if levels < FEWEST_LEVELS:
            found.append(
                Finding(
                    kind=FindingKind.COARSE_STEPS,
                    rank=FindingRank.FIELD,
                    pads=(one.pad.name,),
                    field=name,
                    says=(
                        f"{name} has only {levels} different values up to {top:.3g}, so its "
                        "quantisation is too coarse"
                    ),
                    relative_sd=1.0 / levels,
                    refused=levels < LEVELS_REFUSED,
                )
            )
            continue
        clipped = np.asarray(normal >= top * (1 - 1e-6))
        if clipped.sum() >= CLIPPED_SAMPLES and _smooth_below(normal, top):
            share = float(clipped.sum() / max(one.pressed.sum(), 1))
            found.append(
                Finding(
                    kind=FindingKind.CLIPPED,
                    rank=FindingRank.FIELD,
                    pads=(one.pad.name,),
                    field=name,
                    says=(
                        f"{name} is clipped: {int(clipped.sum())} values are exactly {top:.3g} "
                        f"{'mm' if name == 'displacement' else 'N'}, the maximum; the sensor saturates"
                    ),
                    refused=share > CLIPPED_REFUSED,
                    relative_sd=E_PER_CLIPPED * share,
                )
            )
    return found


def _smooth_below(normal: Float[np.ndarray, "t n"], top: float) -> bool:
    """Whether values just below the greatest are rarer than it: steps would fill them alike."""
    below = (normal < top * (1 - 1e-6)) & (normal > CLIPPED_BELOW * top)
    return bool((normal >= top * (1 - 1e-6)).sum() > CLIPPED_OVER_BELOW * below.sum())
