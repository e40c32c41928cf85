"""The verdict of the mismatch finder in words for staff."""

from __future__ import annotations

from reports.explain_entries import EffectEntry, ExplainEntry, Record
from reports.words import NO_BREAK, NOTHING, UNEXPLAINED, effect_name, percent, with_sd

VERDICTS: dict[str, EffectEntry] = {
    NOTHING: EffectEntry(
        short="nothing is missing",
        meaning="The recordings agree with the model within noise and input uncertainty.",
        advice="Use the modulus as it is.",
    ),
    UNEXPLAINED: EffectEntry(
        short="an effect that drupe does not know",
        meaning="The recordings differ from the model by more than noise and input uncertainty. No known "
        "effect and no pair of known effects explains the difference.",
        advice="Do not trust the modulus of this fruit. Inspect the maps below, check fruit and gripper by "
        "eye, and record the fruit again.",
    ),
}
"""Words of the two verdicts that name no effect; ExplainEntry.effects holds the words of effects."""

LISTED = {NOTHING: "no mismatch", UNEXPLAINED: "an unknown effect"}
"""Both verdicts as items in a list of explanations that the recordings cannot distinguish."""


def parts(effect: str) -> tuple[str, ...]:
    """The single effects of a name, which + joins."""
    return tuple(effect.split("+"))


def words_of(name: str, entry: ExplainEntry) -> EffectEntry | None:
    """Words of a single effect, or of a verdict without effect; None if the entry lacks them."""
    return VERDICTS.get(name) or entry.effects.get(name)


def in_short(effect: str, entry: ExplainEntry) -> str:
    """The short words of an effect, which complete a sentence; for a pair, of both effects."""
    known = [(words_of(part, entry), part) for part in parts(effect)]
    return ", and ".join(effect_name(part) if words is None else words.short for words, part in known)


def explain_verdict(entry: ExplainEntry) -> str:
    """The answer in one to three sentences, and one more on the error that the ± of E excludes."""
    if entry.withheld is not None or not entry.scale_sd:
        return _answer(entry)
    return f"{_answer(entry)} Each ± excludes the sensor's scales, {100 * entry.scale_sd:.1f} % of E."


def _answer(entry: ExplainEntry) -> str:
    named = entry.verdict
    if named == (NOTHING,):
        spread = f"E = {_E(entry.after)}; its error bar includes effects too small to detect"
        if len(entry.grasps) == 1:
            said = "drupe found no mismatch, but one recording cannot show most effects"
            return f"{said} ({spread})."
        return f"drupe found no mismatch: the recordings agree with the model within noise ({spread})."
    if entry.withheld is not None:
        either = " or ".join(LISTED.get(effect, effect_name(effect)) for effect in by_rank(entry))
        what = (
            f"The recording differs from the model, and no known effect explains the difference "
            f"({_chance(entry)})"
            if named == (UNEXPLAINED,)
            else f"This recording cannot distinguish {either}"
        )
        return f"{what}; drupe gives no E: {entry.withheld}."
    if named == (UNEXPLAINED,):
        return (
            f"The recordings differ from the model, and no known effect explains the difference "
            f"({_chance(entry)}). "
            f"Do not trust E = {_E(entry.before)}. "
            f"With the error that such physics causes elsewhere, E is {_E(entry.after)}."
        )
    moved = f"E changes from {_E(entry.before)} to {_E(entry.after)}"
    if len(named) > 1:
        names = [LISTED.get(effect, effect_name(effect)) for effect in by_rank(entry)]
        listed = f"{', '.join(names[:-1])} or {names[-1]}"
        return f"These recordings cannot distinguish {listed}. Averaged over all explanations, {moved}."
    first = in_short(named[0], entry)
    sure = next((candidate.probability for candidate in entry.ranking if candidate.effect == named[0]), None)
    certainty = "" if sure is None else f" ({effect_name(named[0])}, probability {percent(sure)})"
    return f"{first[:1].upper()}{first[1:]}{certainty}. Averaged over all explanations, {moved}."


def by_rank(entry: ExplainEntry) -> tuple[str, ...]:
    """The verdict's names, most probable first."""
    order = {candidate.effect: k for k, candidate in enumerate(entry.ranking)}
    return tuple(sorted(entry.verdict, key=lambda effect: order.get(effect, len(order))))


def where_in_words(entry: ExplainEntry) -> str:
    """The region as a phrase, with centre and size of a spot."""
    region = {"both": "at both pads", "flesh": "in the flesh"}.get(
        entry.where.region, f"at the {entry.where.region}"
    )
    if entry.where.region.startswith("pad "):
        region = f"at the {entry.where.region.removeprefix('pad ')} pad"
    if entry.where.centre_mm is None:
        return region
    at = ", ".join(f"{x:.1f}" for x in entry.where.centre_mm)
    size = f", about {2 * entry.where.radius_mm:.0f} mm wide" if entry.where.radius_mm is not None else ""
    return f"{region}, at ({at}) mm{size}"


def when_in_words(entry: ExplainEntry) -> str:
    """The phase of the grasp in which the effect shows."""
    return {
        "load": "while it is squeezed",
        "hold": "while it is held",
        "unload": "while it is let go",
        "all": "all the time",
    }.get(entry.when, entry.when)


def component_in_words(entry: ExplainEntry) -> str:
    """The component that shows the effect."""
    return {
        "normal": "straight into the skin",
        "shear": "along the skin",
        "both": "into and along the skin",
    }.get(entry.component, entry.component)


def _E(modulus: Record) -> str:
    return f"{with_sd(modulus.value, modulus.sd)} MPa".replace(" ", NO_BREAK)


def _chance(entry: ExplainEntry) -> str:
    return f"p = {entry.p_value:.2g}" + (", nominal" if entry.p_nominal else "")
