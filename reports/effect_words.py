"""Every effect that the mismatch finder can name, in words for staff: what it means, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

from reports.explain_entries import ExplainEntry
from reports.words import NO_BREAK, effect_name, percent, with_sd


@dataclass(frozen=True, kw_only=True)
class EffectWords:
    """`short` completes "Most likely ..."; `meaning` and `advice` are whole sentences."""

    short: str
    meaning: str
    advice: str


EFFECTS: dict[str, EffectWords] = {
    "none": EffectWords(
        short="nothing is missing",
        meaning="The recordings agree with the model within their noise and what is not known exactly.",
        advice="Nothing needs doing: use the modulus as it is.",
    ),
    "unknown": EffectWords(
        short="something that none of the known effects explains",
        meaning="The recordings differ from the model in a way that repeats from grasp to grasp, and no "
        "known effect, alone or in pairs, accounts for it.",
        advice="Do not trust the modulus of this fruit. Look at the maps below, check fruit and gripper by "
        "eye, and record the fruit again.",
    ),
    "viscoelastic": EffectWords(
        short="the flesh creeps: it gives way slowly under a steady load",
        meaning="Part of the flesh's resistance fades over time, so the same squeeze feels softer the longer "
        "it lasts. All wet flesh does this; here it is strong enough to matter.",
        advice="Compare fruit at the same speed and hold time, or apply the effect to the batch so that the "
        "modulus is the one at the first instant.",
    ),
    "stiffening": EffectWords(
        short="the flesh stiffens the further it is pressed",
        meaning="The resistance grows faster than the squeeze: a deep grasp makes the fruit look firmer "
        "than a light one. Some of it is large deformation alone, which no soft fruit is without.",
        advice="Grasp all fruit equally deep and gently, or apply the effect so that the modulus is that of "
        "the first touch.",
    ),
    "skin": EffectWords(
        short="a stiff skin carries part of the load",
        meaning="The skin works like a membrane stretched over the flesh: the fruit looks firmer than it is.",
        advice="Apply the effect to the batch: the modulus is then that of the flesh under the skin.",
    ),
    "graded_modulus": EffectWords(
        short="the flesh is not equally firm from skin to pit",
        meaning="Firmness changes with depth: fruit often softens from the outside in, or around the pit.",
        advice="Read the modulus as that of the flesh halfway between skin and pit.",
    ),
    "soft_spot": EffectWords(
        short="there is a soft spot, such as a bruise",
        meaning="One place in the flesh is much softer than the rest. It is marked on the fruit below.",
        advice="Look at the fruit there, cut it open if in doubt, and sort it as bruised. The modulus given "
        "afterwards is that of the sound flesh.",
    ),
    "anisotropy": EffectWords(
        short="the flesh is firmer along the stem axis than across it, or the other way round",
        meaning="Fibres make the flesh resist differently in different directions.",
        advice="Grasp all fruit in the same direction, or apply the effect to the batch.",
    ),
    "poisson_ratio": EffectWords(
        short="the flesh keeps its volume more, or less, than assumed",
        meaning="Squeezed flesh bulges sideways by another share than the settings say (Poisson's ratio).",
        advice="Apply the effect: the ratio goes into the batch's settings.",
    ),
    "pit_offset": EffectWords(
        short="the pit does not sit where it is expected",
        meaning="The pit is off its usual place, so that the flesh is thinner on one side.",
        advice="Apply the effect for this fruit. Where many fruit of a lot show it, change the pit prior.",
    ),
    "pit_size": EffectWords(
        short="the pit is larger or smaller than expected",
        meaning="The pit's size differs from the category's by more than usual.",
        advice="Apply the effect for this fruit. Where a cultivar always shows it, give the batch a pit "
        "prior of its own.",
    ),
    "loose_pit": EffectWords(
        short="the pit is loose in its hollow",
        meaning="There is a gap between flesh and pit (a freestone): the flesh gives way easily at first, "
        "until it meets the pit.",
        advice="Nothing is wrong with the fruit. Read the modulus with the gap taken out.",
    ),
    "slip": EffectWords(
        short="the fruit slips between the pads",
        meaning="The pads slide over the skin: wax, juice or dust makes it slippery.",
        advice="Wipe fruit and pads dry, close the gripper a little further and slower, and record again.",
    ),
    "plastic_set": EffectWords(
        short="the grasp itself leaves a lasting dent",
        meaning="The flesh does not spring back: it was pressed beyond what it bears.",
        advice="Lower the gripper's force for this lot; the fruit grasped so far may show bruises.",
    ),
    "damage": EffectWords(
        short="the flesh is softer the second time it is pressed",
        meaning="The first squeeze breaks some of the flesh's structure, so that later ones meet less "
        "resistance.",
        advice="Use the first squeeze of every fruit only, lower the force, and do not grasp a place twice.",
    ),
    "sensor_gain": EffectWords(
        short="one pad reads its force too high or too low",
        meaning="The pads disagree about the same squeeze by a constant factor: one is out of calibration.",
        advice="Calibrate this pad with a weight. Until then apply the effect: forces of the whole batch are "
        "corrected by the factor found.",
    ),
    "sensor_drift": EffectWords(
        short="the force reading of one pad drifts with time",
        meaning="The pad's reading creeps although the load is steady: a warming gel, a tired membrane.",
        advice="Let the sensor warm up, zero it before every grasp, and apply the effect to the recordings "
        "made so far.",
    ),
    "gripper_compliance": EffectWords(
        short="the gripper itself gives way under load",
        meaning="Jaws or mount bend, so that they travel less than the machine reports.",
        advice="Tighten the jaws. Apply the effect: travel is then corrected by what the jaws give way.",
    ),
    "clock_lag": EffectWords(
        short="the sensor's clock and the gripper's are apart",
        meaning="Gel frames and jaw positions were stamped by clocks that differ by a fraction of a second.",
        advice="Synchronise the clocks in the recorder. Apply the effect to the recordings made so far.",
    ),
    "pose_error": EffectWords(
        short="one pad is not where the gripper's calibration says",
        meaning="A pad sits shifted or tilted against its recorded place.",
        advice="Repeat the hand-eye calibration. Apply the effect to the recordings made so far.",
    ),
}
"""By the names of the vocabulary; pairs are two of these."""


def parts(effect: str) -> tuple[str, ...]:
    """The single effects of a name."""
    return tuple(effect.split("+"))


def in_short(effect: str) -> str:
    """What the effect is, to complete a sentence; of a pair, both."""
    known = [EFFECTS[part].short if part in EFFECTS else effect_name(part) for part in parts(effect)]
    return ", and ".join(known)


def explain_verdict(found: ExplainEntry) -> str:
    """The whole answer in one sentence (two where E changes)."""
    named = found.verdict
    if named == ("none",):
        return (
            f"Nothing is missing: the recordings agree with the model within their noise "
            f"(E = {_E(found.E_before_MPa, found.E_before_sd_MPa)})."
        )
    if named == ("unknown",):
        return (
            f"The recordings differ from the model by something that none of the known effects explains "
            f"({_chance(found.p_value)}); E = {_E(found.E_before_MPa, found.E_before_sd_MPa)} is not to be "
            "trusted."
        )
    moved = (
        f"taken into account, E goes from {_E(found.E_before_MPa, found.E_before_sd_MPa)} to "
        f"{_E(found.E_after_MPa, found.E_after_sd_MPa)}"
    )
    if len(named) > 1:
        names = [effect_name(effect) for effect in by_rank(found)]
        listed = f"{', '.join(names[:-1])} or {names[-1]}"
        return f"These recordings cannot tell apart: {listed}; with the likeliest of them {moved}."
    first = in_short(named[0])
    sure = next((one.probability for one in found.ranking if one.effect == named[0]), None)
    certainty = "" if sure is None else f" ({effect_name(named[0])}, probability {percent(sure)})"
    return f"{first[:1].upper()}{first[1:]}{certainty}; {moved}."


def by_rank(found: ExplainEntry) -> tuple[str, ...]:
    """The verdict's names, the likeliest first."""
    order = {one.effect: k for k, one in enumerate(found.ranking)}
    return tuple(sorted(found.verdict, key=lambda effect: order.get(effect, len(order))))


def where_in_words(found: ExplainEntry) -> str:
    """The region as a phrase, with centre and size of a spot."""
    region = {"both": "at both pads", "flesh": "in the flesh"}.get(found.region, f"at the {found.region}")
    if found.region.startswith("pad "):
        region = f"at the {found.region.removeprefix('pad ')} pad"
    if found.centre_mm is None:
        return region
    at = ", ".join(f"{x:.1f}" for x in found.centre_mm)
    size = f", about {2 * found.radius_mm:.0f} mm wide" if found.radius_mm is not None else ""
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


def _E(value: float, sd: float) -> str:
    return f"{with_sd(value, sd)} MPa".replace(" ", NO_BREAK)


def _chance(p_value: float) -> str:
    return f"p = {p_value:.2g}"
