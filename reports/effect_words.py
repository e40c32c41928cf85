"""The verdict of the mismatch finder in words for staff, in the language in force."""

from __future__ import annotations

from reports.explain_entries import EffectEntry, ExplainEntry, Record
from reports.language import decimals, say
from reports.messages import message
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

REGIONS = {"both": "at both pads", "flesh": "in the flesh"}
PHASES = {
    "load": "while it is squeezed",
    "hold": "while it is held",
    "unload": "while it is let go",
    "all": "all the time",
}
COMPONENTS = {
    "normal": "straight into the skin",
    "shear": "along the skin",
    "both": "into and along the skin",
}
"""Phrases for the region, the phase and the component of an answer."""


def parts(effect: str) -> tuple[str, ...]:
    """The single effects of a name, which + joins."""
    return tuple(effect.split("+"))


def words_of(name: str, entry: ExplainEntry) -> EffectEntry | None:
    """Words of a single effect, or of a verdict without effect; None if the entry lacks them."""
    known = VERDICTS.get(name)
    if known is None:
        return entry.effects.get(name)
    return EffectEntry(**{field: say(text) for field, text in vars(known).items()})


def in_short(effect: str, entry: ExplainEntry) -> str:
    """The short words of an effect, which complete a sentence; for a pair, of both effects."""
    known = [(words_of(part, entry), part) for part in parts(effect)]
    each = [effect_name(part) if words is None else words.short for words, part in known]
    return say(", and ").join(each)


def explain_verdict(entry: ExplainEntry) -> str:
    """The answer in one to three sentences. Two more say what one recording cannot confirm, and which error
    the ± of E excludes.
    """
    said = [_answer(entry)]
    if len(entry.grasps) == 1 and entry.verdict[0] not in VERDICTS:
        said.append(say("One recording cannot confirm an effect: record another."))
    if entry.withheld is None and entry.scale_sd:
        share = decimals(f"{100 * entry.scale_sd:.1f}")
        said.append(say("Each ± excludes the sensor's scales, {share} % of E.", share=share))
    return " ".join(said)


def _answer(entry: ExplainEntry) -> str:
    named = entry.verdict
    if named == (NOTHING,):
        if len(entry.grasps) == 1:
            return say(
                "drupe found no mismatch, but one recording cannot show most effects "
                "(E = {modulus}; its error bar includes effects too small to detect).",
                modulus=_E(entry.after),
            )
        return say(
            "drupe found no mismatch: the recordings agree with the model within noise "
            "(E = {modulus}; its error bar includes effects too small to detect).",
            modulus=_E(entry.after),
        )
    if entry.withheld is not None:
        why = entry.withheld
        if named == (UNEXPLAINED,):
            return say(
                "The recording differs from the model, and no known effect explains the difference "
                "({chance}); drupe gives no E: {why}.",
                chance=_chance(entry),
                why=why,
            )
        return say(
            "This recording cannot distinguish {effects}; drupe gives no E: {why}.",
            effects=say(" or ").join(_listed(entry)),
            why=why,
        )
    if named == (UNEXPLAINED,):
        return say(
            "The recordings differ from the model, and no known effect explains the difference ({chance}). "
            "Do not trust E = {before}. With the error that such physics causes elsewhere, E is {after}.",
            chance=_chance(entry),
            before=_E(entry.before),
            after=_E(entry.after),
        )
    moved = say(
        "Averaged over all explanations, E changes from {before} to {after}.",
        before=_E(entry.before),
        after=_E(entry.after),
    )
    if len(named) > 1:
        *names, last = _listed(entry)
        listed = f"{', '.join(names)}{say(' or ')}{last}"
        return f"{say('These recordings cannot distinguish {effects}.', effects=listed)} {moved}"
    first = in_short(named[0], entry)
    sure = next((candidate.probability for candidate in entry.ranking if candidate.effect == named[0]), None)
    certainty = (
        ""
        if sure is None
        else f" ({effect_name(named[0])}, {say('probability {share}', share=percent(sure))})"
    )
    return f"{first[:1].upper()}{first[1:]}{certainty}. {moved}"


def _listed(entry: ExplainEntry) -> list[str]:
    """The verdict's names as items of a list, most probable first."""
    return [say(LISTED[name]) if name in LISTED else effect_name(name) for name in by_rank(entry)]


def by_rank(entry: ExplainEntry) -> tuple[str, ...]:
    """The verdict's names, most probable first."""
    order = {candidate.effect: k for k, candidate in enumerate(entry.ranking)}
    return tuple(sorted(entry.verdict, key=lambda effect: order.get(effect, len(order))))


def where_in_words(entry: ExplainEntry) -> str:
    """The region as a phrase, with centre and size of a spot."""
    name = entry.where.region
    if name in REGIONS:
        region = say(REGIONS[name])
    elif name.startswith("pad "):
        region = say("at the {pad} pad", pad=message(name.removeprefix("pad ")))
    else:
        region = say("at the {place}", place=message(name))
    if entry.where.centre_mm is None:
        return region
    at = "; ".join(decimals(f"{x:.1f}") for x in entry.where.centre_mm)
    if entry.where.radius_mm is None:
        return say("{region}, at ({place}) mm", region=region, place=at)
    return say(
        "{region}, at ({place}) mm, about {width} mm wide",
        region=region,
        place=at,
        width=f"{2 * entry.where.radius_mm:.0f}",
    )


def when_in_words(entry: ExplainEntry) -> str:
    """The phase of the grasp in which the effect shows."""
    return say(PHASES[entry.when]) if entry.when in PHASES else entry.when


def component_in_words(entry: ExplainEntry) -> str:
    """The component that shows the effect."""
    return say(COMPONENTS[entry.component]) if entry.component in COMPONENTS else entry.component


def _E(modulus: Record) -> str:
    return f"{with_sd(modulus.value, modulus.sd)} MPa".replace(" ", NO_BREAK)


def _chance(entry: ExplainEntry) -> str:
    p_value = decimals(f"p = {entry.p_value:.2g}")
    return f"{p_value}, {say('nominal')}" if entry.p_nominal else p_value
