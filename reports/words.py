"""Figures and outcomes in words that quality-control staff read."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC

from reports.entries import OR, FruitEntry, ScreenEntry, Suspect, Suspicion, VerdictEntry, ranked
from reports.history_entries import FirmnessEntry, LotName
from reports.language import decimals as with_comma
from reports.language import say
from reports.messages import message

UNKNOWN = "–"
NO_BREAK = "\u00a0"
CATEGORIES = ("apricot", "cherry", "nectarine", "peach", "phantom", "plum")
"""Shipped kinds of fruit. A user's own has the name of its file."""
NOTHING, UNEXPLAINED = "none", "unknown"
"""The two verdicts that name no effect: no mismatch, and a mismatch that no known effect explains."""
SMALLEST_P = 0.001
"""Pages show smaller p-values only as "< 0.001": they rest on few of 2,000 draws."""

_ADVICE = {
    "withheld-modulus": (
        "Squeeze the fruit again, deeper and at constant speed. To correct for the rig's "
        "compliance, use drupe convert --rig."
    ),
    "no-shape": "Put the photos of this fruit into its photos folder, or a ready mesh as fruit.ply.",
    "too-few-views": (
        "Take more photos from all sides and from two heights; neighbouring photos must overlap."
    ),
    "no-overlap": "Take more photos from all sides and from two heights; neighbouring photos must overlap.",
    "unreadable-photo": "Copy the named photo from the camera again, or delete it, then run the batch again.",
    "no-fruit": "Check that the whole fruit is in the picture, sharp and well lit.",
    "fruit-cut-off": "Take the photos from farther away; each must show the whole fruit.",
    "no-scale": "Give height_mm in fruits.csv, or photograph the fruit on the printed marker mat.",
    "mat-not-found": "Photograph the fruit on the mat that mat.json describes, tags sharp and in full view.",
    "bad-mat": "Write mat.json again with the command drupe mat.",
    "no-surface": "Take more photos in even light, without glare on the skin.",
    "not-watertight": "Repair the mesh, or take photos of the sides where it has holes.",
    "unreadable-mesh": "Export the mesh again as PLY, in millimetres.",
    "no-prior": "Name a known category in batch.toml, or give a pit prior file of your own.",
    "pit-outside-fruit": (
        "Check that the mesh is in millimetres and that the pit prior belongs to this category."
    ),
    "no-grasp": "Record at least one grasp of this fruit and put its .h5 file into the grasps folder.",
    "unreadable-recording": "Write the named recording again from the gripper's own data.",
    "never-touches": "Check that the gripper closed on the fruit, then record the grasp again.",
    "pads-off-fruit": "Check the gripper's calibration and the orientation of stem and suture.",
    "implausible-recording": "Correct the fault above in the recording, or record the grasp again.",
    "foreign-recording": "Move the recording to the fruit in its fruit_id, or correct the fruit_id.",
    "repeated-recording": "Remove one of the two files, or replace it by the intended grasp.",
    "implausible-pit": (
        "Put this fruit's own pit into pit.ply, or remove pit.ply; drupe then uses the category's pit."
    ),
    "implausible-modulus": "Check forces, displacements and meshes for wrong units or factors.",
    "timed-out": "Run the batch again with a longer time limit; drupe keeps finished fruit.",
    "out-of-memory": "Run the batch again with fewer jobs; drupe keeps finished fruit.",
    "crashed": "Run the batch again; if this fruit stops again, report it with its files.",
    "internal-error": "Report this internal error with traceback.txt from this fruit's results.",
}
_ADVICE_OTHERWISE = "Correct the fault above, then run the batch again; drupe keeps finished fruit."


def advice(fruit: FruitEntry) -> str:
    """What to do next about a fruit that was not graded."""
    return say(_ADVICE.get(fruit.outcome, _ADVICE_OTHERWISE))


def remarks(fruit: FruitEntry) -> str:
    """Notes that a reader needs before trusting a fruit's row; empty without any."""
    if not fruit.ok:
        return f"{say('not graded')}: {fruit.outcome}"
    notes = [say("reference body")] if fruit.reference else []
    if fruit.mismatch and fruit.mismatch != NOTHING:
        taken = f" ({say('taken into account')})" if fruit.mismatch_taken else ""
        doubt = f", {say('do not trust E')}" if fruit.mismatch == UNEXPLAINED else ""
        notes.append(f"{say('mismatch')}: {effect_name(fruit.mismatch)}{taken}{doubt}")
    if fruit.E_uncorrected_MPa is not None:
        notes.append(say("E corrected by the reference body"))
    if fruit.doubts:
        notes.append(say("E is in doubt, so no class") if fruit.class_withheld else say("E is in doubt"))
    if fruit.warnings:
        count = len(fruit.warnings)
        notes.append(say("1 warning") if count == 1 else say("{count} warnings", count=count))
    return ", ".join(notes)


def verdict_words(verdict: VerdictEntry) -> str:
    """A person's verdict as a sentence without a full stop, with E at that time."""
    E_then = f"{with_sd(verdict.E_MPa, verdict.E_sd_MPa)} MPa" if verdict.E_MPa is not None else UNKNOWN
    said = say(
        "{by} judged it {judged} on {day} (E = {modulus}): {why}",
        by=verdict.by,
        judged=verdict.judged_class,
        day=verdict.at_utc.astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        modulus=E_then.replace(" ", NO_BREAK),
        why=verdict.why.rstrip("."),
    )
    return (
        f"{said}. {say('The verdict is about an earlier revision of this result')}"
        if verdict.earlier
        else said
    )


def screen_words(screen: ScreenEntry) -> str:
    """The screen's suspects, or why it did not run, in a line; empty if it found nothing.

    >>> from reports.entries import ScreenEntry, Suspect
    >>> skin = Suspect(name="skin", short="a stiff skin carries part of the load", advice="")
    >>> screen_words(ScreenEntry(p_value=0.01, suspects=(skin,)))
    'missing physics suspected, a stiff skin carries part of the load (run drupe explain for details)'
    """
    if screen.why_not:
        return f"not tested for missing physics: {screen.why_not}"
    if not screen.suspects:
        return ""
    return f"missing physics suspected, {suspect_words(screen.suspects)} (run drupe explain for details)"


def suspect_words(suspects: Sequence[Suspect]) -> str:
    """The most probable suspect in words, and the names of the others."""
    first, *others = suspects
    like = f", or {' or '.join(effect_name(other.name) for other in others)}" if others else ""
    return f"{first.short}{like}"


def suspicion_words(suspicion: Suspicion) -> str:
    """The suspected effect, p, and E without and with it.

    >>> doubt = Suspicion(effect="plastic_set", p_value=6e-41, E_MPa=0.416, E_sd_MPa=0.04, maturity="ripe",
    ...                   E_with_MPa=0.513, E_with_sd_MPa=0.05, maturity_with="firm")
    >>> suspicion_words(doubt).replace(NO_BREAK, " ")
    'plastic set (p = 6.0e-41), E is 0.416 ± 0.040 MPa (ripe) without it and 0.513 ± 0.050 MPa (firm) with it'
    """
    effect = effect_name(suspicion.effect) or say("no single effect")
    without = _with_class(suspicion.E_MPa, suspicion.E_sd_MPa, suspicion.maturity)
    p_value = number(suspicion.p_value, figures=2) + (f", {say('nominal')}" if suspicion.p_nominal else "")
    if suspicion.E_with_MPa is None:
        return say(
            "{effect} (p = {p}), E is {without} without it and unknown with it",
            effect=effect,
            p=p_value,
            without=without,
        )
    return say(
        "{effect} (p = {p}), E is {without} without it and {with_it} with it",
        effect=effect,
        p=p_value,
        without=without,
        with_it=_with_class(suspicion.E_with_MPa, suspicion.E_with_sd_MPa, suspicion.maturity_with),
    )


def _with_class(E_MPa: float, E_sd_MPa: float | None, maturity: str) -> str:
    value = f"{with_sd(E_MPa, E_sd_MPa)} MPa".replace(" ", NO_BREAK)
    return f"{value} ({maturity})" if maturity else value


def p_words(p_value: float | None, nominal: bool = False) -> str:
    """A p-value in brackets, with a space before; empty if unknown. `nominal`: not calibrated.

    >>> [p_words(p).replace(NO_BREAK, " ") for p in (0.432, 0.0123, 1e-7, None)]
    [' (p = 0.43)', ' (p = 0.012)', ' (p < 0.001)', '']
    >>> p_words(0.432, nominal=True).replace(NO_BREAK, " ")
    ' (p = 0.43, nominal)'
    """
    if p_value is None or not math.isfinite(p_value):
        return ""
    said = f"< {SMALLEST_P:g}" if p_value < SMALLEST_P else f"= {number(p_value, figures=2)}"
    said += f", {say('nominal')}" if nominal else ""
    return (
        f" (p {said})".replace("p ", f"p{NO_BREAK}")
        .replace("= ", f"={NO_BREAK}")
        .replace("< ", f"<{NO_BREAK}")
    )


def effect_name(effect: str) -> str:
    """Readable name of an effect, of a pair (+), or of alternatives (|), in the language in force.

    >>> effect_name("pit_offset+viscoelastic|slip")
    'pit offset with viscoelastic or slip'
    """
    alternatives = (pair.split("+") for pair in effect.split(OR))
    pairs = (say(" with ").join(message(name.replace("_", " ")) for name in pair) for pair in alternatives)
    return say(" or ").join(pairs)


def lot_words(name: LotName) -> str:
    """Cultivar, lot, day and size in the language in force.

    >>> lot_words(LotName(category="plum", cultivar="Jojo", lot="7", size=""))
    'plum Jojo, lot 7, size not stated'
    """
    parts = [" ".join(filter(None, (category_name(name.category), name.cultivar)))]
    if name.lot is not None:
        parts.append(f"{say('lot')} {name.lot}" if name.lot else say("without a lot"))
    if name.day is not None:
        parts.append(f"{name.day}")
    if name.size is not None:
        parts.append(f"{say('size')} {name.size or say('not stated')}")
    return ", ".join(parts)


def plunger_words(relation: FirmnessEntry) -> str:
    """Cultivar and plunger of a penetrometer in the language in force."""
    diameter = with_comma(f"{relation.plunger_mm:g}")
    return say("{group}, plunger of {diameter} mm", group=lot_words(relation.name), diameter=diameter)


def reading_title(title: str) -> str:
    """Title of a simulated firmness test in the language in force; its figures stay beside their units."""
    return re.sub(r"(?<=\d) (?=%|gf|mm|N\b)", NO_BREAK, message(title))


def category_name(category: str) -> str:
    """A shipped kind of fruit in the language in force; another name as it is."""
    return say(category) if category in CATEGORIES else category


def number(value: float | None, *, figures: int = 3) -> str:
    """A number with `figures` significant digits, and an exponent only beyond eight decimals.

    >>> number(104123.7), number(0.03217), number(None)
    ('104124', '0.0322', '–')
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if value == 0.0:
        return "0"
    decimals = figures - 1 - math.floor(math.log10(abs(value)))
    return with_comma(f"{value:.{max(decimals, 0)}f}" if decimals <= 8 else f"{value:.{figures - 1}e}")


def with_sd(value: float | None, sd: float | None) -> str:
    """Value ± standard deviation to the second digit of the deviation, at most the value's fifth.

    >>> with_sd(0.32143, 0.0121), with_sd(0.32143, None), with_sd(None, None)
    ('0.321 ± 0.012', '0.321', '–')
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if sd is None or not math.isfinite(sd) or sd <= 0.0:
        return number(value)
    decimals = 1 - math.floor(math.log10(sd))
    finest = 4 - math.floor(math.log10(abs(value))) if value else decimals
    decimals = max(min(decimals, finest), 0)
    return with_comma(f"{value:.{decimals}f} ± {sd:.{decimals}f}")


def percent(probability: float | None) -> str:
    """A probability in whole percent, never 0 or 100 %, with a no-break space.

    >>> [percent(p).replace(NO_BREAK, " ") for p in (0.9999, 0.731, 0.0002, None)]
    ['>99 %', '73 %', '<1 %', '–']
    """
    if probability is None or not math.isfinite(probability):
        return UNKNOWN
    if probability > 0.99:
        return f">99{NO_BREAK}%"
    return f"<1{NO_BREAK}%" if probability < 0.01 else f"{100 * probability:.0f}{NO_BREAK}%"


def share(part: float) -> str:
    """A share of counted fruit in whole percent, with a no-break space; 0 and 100 % are none and all.

    >>> [share(part).replace(NO_BREAK, " ") for part in (0.0, 0.004, 0.35, 1.0)]
    ['0 %', '<1 %', '35 %', '100 %']
    """
    return f"{100 * part:.0f}{NO_BREAK}%" if part in {0.0, 1.0} else percent(part)


def duration(seconds: float) -> str:
    """Wall time for people.

    >>> duration(3.21), duration(192.0), duration(7384.0)
    ('3.2 s', '3 min 12 s', '2 h 3 min')
    """
    if seconds < 60.0:
        return with_comma(f"{seconds:.1f} s")
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def verdict(fruits: tuple[FruitEntry, ...], *, waiting: int = 0) -> str:
    """The batch in one sentence: how many are graded, the softest and the firmest, how many are not.

    `waiting`: fruit of an unfinished run that are not done.
    """
    graded = [fruit for fruit in ranked(fruits) if fruit.E_MPa is not None and fruit.ok]
    failed = sum(not fruit.ok for fruit in fruits)
    total = len(fruits) + waiting
    if waiting and not graded:
        return say("{count} of {total} fruit graded", count=0, total=total) + "."
    if not graded:
        if len(fruits) < 2:
            return say("The only fruit is not graded.") if fruits else say("The batch holds no fruit.")
        return say("None of the {total} fruit is graded.", total=len(fruits))
    lead = say("All {total} fruit graded", total=len(fruits))
    if failed or waiting:
        lead = say("{count} of {total} fruit graded", count=len(graded), total=total)
    if total == 1:
        lead = say("The only fruit is graded")
    softest, firmest = graded[0], graded[-1]
    if softest is firmest:
        sentence = say("{fruit} has E = {modulus}", fruit=softest.fruit_id, modulus=_modulus(softest))
    else:
        sentence = say(
            "the softest is {softest} ({of_softest}), the firmest {firmest} ({of_firmest})",
            softest=softest.fruit_id,
            of_softest=_modulus(softest),
            firmest=firmest.fruit_id,
            of_firmest=_modulus(firmest),
        )
    rest = ""
    if failed == 1:
        rest = "; " + say("1 is not graded and needs attention")
    elif failed:
        rest = "; " + say("{count} are not graded and need attention", count=failed)
    return f"{lead}: {sentence}{rest}."


def _modulus(fruit: FruitEntry) -> str:
    words = f"{with_sd(fruit.E_MPa, fruit.E_sd_MPa)} MPa".replace(" ", NO_BREAK)
    if fruit.doubts:
        return f"{words}, {say('in doubt')}"
    return f"{words}, {fruit.maturity}" if fruit.maturity else words
