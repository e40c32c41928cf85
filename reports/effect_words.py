"""The verdict of the mismatch finder in words for staff."""

from __future__ import annotations

from reports.explain_entries import EffectEntry, ExplainEntry, ModulusEntry
from reports.words import NO_BREAK, NOTHING, UNEXPLAINED, effect_name, percent, with_sd

VERDICTS: dict[str, EffectEntry] = {
    NOTHING: EffectEntry(
        short="nothing is missing",
        meaning="The recordings agree with the model within their noise and what is not known exactly.",
        advice="Nothing needs doing: use the modulus as it is.",
    ),
    UNEXPLAINED: EffectEntry(
        short="something that none of the known effects explains",
        meaning="The recordings differ from the model by more than noise and what is not known exactly, and "
        "no known effect, alone or in pairs, accounts for it.",
        advice="Do not trust the modulus of this fruit. Look at the maps below, check fruit and gripper by "
        "eye, and record the fruit again.",
    ),
}
"""The two verdicts that are no effect; the words of effects come with the entry (ExplainEntry.effects)."""


def parts(effect: str) -> tuple[str, ...]:
    """The single effects of a name."""
    return tuple(effect.split("+"))


def words_of(name: str, found: ExplainEntry) -> EffectEntry | None:
    """Of a single effect or a verdict that is none; None where the entry does not bring them."""
    return VERDICTS.get(name) or found.effects.get(name)


def in_short(effect: str, found: ExplainEntry) -> str:
    """What the effect is, to complete a sentence; of a pair, both."""
    known = [(words_of(part, found), part) for part in parts(effect)]
    return ", and ".join(effect_name(part) if words is None else words.short for words, part in known)


def explain_verdict(found: ExplainEntry) -> str:
    """The whole answer in one sentence (two where E changes)."""
    named = found.verdict
    if named == (NOTHING,):
        spread = f"E = {_E(found.E_MPa.after)}, its spread counts what is too small to be found"
        if len(found.grasps) == 1:
            return f"Nothing is found to be missing, but one recording cannot show most effects ({spread})."
        return (
            "Nothing is found to be missing: the recordings agree with the model within their noise "
            f"({spread})."
        )
    if found.E_withheld is not None:
        either = " or ".join(effect_name(effect) for effect in by_rank(found))
        what = (
            "The recording differs from the model by something that none of the known effects explains "
            f"({_chance(found.p_value)})"
            if named == (UNEXPLAINED,)
            else f"This recording cannot tell apart: {either}"
        )
        return f"{what}; E is withheld: {found.E_withheld}."
    if named == (UNEXPLAINED,):
        return (
            f"The recordings differ from the model by something that none of the known effects explains "
            f"({_chance(found.p_value)}); E = {_E(found.E_MPa.before)} is not to be "
            f"trusted: as uncertain as such physics has made it elsewhere, it is {_E(found.E_MPa.after)}."
        )
    moved = f"E goes from {_E(found.E_MPa.before)} to {_E(found.E_MPa.after)}"
    if len(named) > 1:
        names = [effect_name(effect) for effect in by_rank(found)]
        listed = f"{', '.join(names[:-1])} or {names[-1]}"
        return f"These recordings cannot tell apart: {listed}; with them, as likely as each is, {moved}."
    first = in_short(named[0], found)
    sure = next((one.probability for one in found.ranking if one.effect == named[0]), None)
    certainty = "" if sure is None else f" ({effect_name(named[0])}, probability {percent(sure)})"
    return f"{first[:1].upper()}{first[1:]}{certainty}; taken into account, {moved}."


def by_rank(found: ExplainEntry) -> tuple[str, ...]:
    """The verdict's names, the likeliest first."""
    order = {one.effect: k for k, one in enumerate(found.ranking)}
    return tuple(sorted(found.verdict, key=lambda effect: order.get(effect, len(order))))


def where_in_words(found: ExplainEntry) -> str:
    """The region as a phrase, with centre and size of a spot."""
    region = {"both": "at both pads", "flesh": "in the flesh"}.get(
        found.where.region, f"at the {found.where.region}"
    )
    if found.where.region.startswith("pad "):
        region = f"at the {found.where.region.removeprefix('pad ')} pad"
    if found.where.centre_mm is None:
        return region
    at = ", ".join(f"{x:.1f}" for x in found.where.centre_mm)
    size = f", about {2 * found.where.radius_mm:.0f} mm wide" if found.where.radius_mm is not None else ""
    return f"{region}, at ({at}) mm{size}"


def when_in_words(found: ExplainEntry) -> str:
    """The phase of the grasp."""
    return {
        "load": "while it is squeezed",
        "hold": "while it is held",
        "unload": "while it is let go",
        "all": "all the time",
    }.get(found.when, found.when)


def component_in_words(found: ExplainEntry) -> str:
    """Which component shows it."""
    return {
        "normal": "straight into the skin",
        "shear": "along the skin",
        "both": "into and along the skin",
    }.get(found.component, found.component)


def _E(modulus: ModulusEntry) -> str:
    return f"{with_sd(modulus.value, modulus.sd)} MPa".replace(" ", NO_BREAK)


def _chance(p_value: float) -> str:
    return f"p = {p_value:.2g}"
