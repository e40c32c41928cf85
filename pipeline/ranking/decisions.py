"""Decides on each fruit: ship it, hold it, or inspect it.

E's error is assumed lognormal, as for the classes (pipeline.ranking.maturity): with the class limits b_k,
class k has the probability

    P_k = Phi((log b_k - log E) / s) - Phi((log b_(k-1) - log E) / s),      s = sd/E

and the probability of shipping the fruit is the sum of P_k over the classes that are shipped.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fem.mismatch.result import UNKNOWN
from pipeline.batch.records import DiagnosisRecord, FruitRecord
from pipeline.batch.settings import Grading
from pipeline.ranking.maturity import Rank, maturity
from reports.entries import HOLD, INSPECT, SHIP, Suspicion
from reports.words import percent, suspicion_words

IMPROBABLE = "missing physics suspected"
OTHER_CLASS = "the suspected effect changes its class"


@dataclass(frozen=True, kw_only=True)
class Decision:
    """Fields of a FruitEntry: the fruit's list (SHIP, HOLD, INSPECT; empty: none), the reason for INSPECT,
    and the likeliest other class with its probability, if its own is not certain. `suspicion`: what the
    reason says about E with an effect that E excludes.
    """

    decision: str = ""
    decision_reason: str = ""
    suspicion: Suspicion | None = None
    other_class: str | None = None
    other_class_probability: float | None = None


def decide(
    record: FruitRecord,
    place: Rank | None,
    grading: Grading,
    *,
    mismatch: str | None,
    explained: DiagnosisRecord | None = None,
) -> Decision:
    """The fruit's list; a reference body is on none, nor is a fruit with no cause for INSPECT if no class
    limits are set.

    `mismatch`: the effect missing in the model, as in the report. `explained`: the answer of `drupe explain`
    for the same inputs.
    """
    if record.given.reference:
        return Decision()
    inspect = partial(Decision, decision=INSPECT)
    if not record.graded or place is None:
        return inspect(decision_reason="not graded")
    if record.doubts:
        return inspect(decision_reason="E is in doubt")
    suspected = () if record.screen is None else record.screen.names
    if UNKNOWN in ((mismatch or "").split("|")[0], *suspected[:1]):
        return inspect(decision_reason="no known effect explains its recordings")
    other = _other_class(place, grading)
    if (missing := _missing_physics(record, place, grading, explained)) is not None:
        head, suspicion = missing
        reason = f"{head}: {suspicion_words(suspicion)}"
        return inspect(decision_reason=reason, suspicion=suspicion, **other)
    shipped = grading.shipped
    if shipped is None:
        return Decision()
    chance = ship_probability(place.class_probabilities, shipped)
    if 1 - grading.certainty < chance < grading.certainty:
        return inspect(decision_reason=f"borderline: ship with probability {percent(chance)}", **other)
    return Decision(decision=SHIP if chance >= grading.certainty else HOLD, **other)


def _missing_physics(
    record: FruitRecord, place: Rank, grading: Grading, explained: DiagnosisRecord | None
) -> tuple[str, Suspicion] | None:
    """Why E without a suspected effect is not enough to ship or hold a fruit; None if it is.

    Either the screen's p is below the batch's limit, or E with the effect is in another class. If `drupe
    explain` has an answer, its E replaces the screen's.
    """
    if record.modulus is None:
        return None
    screen, E_MPa, E_sd_MPa = record.screen, record.modulus.E_MPa, record.modulus.E_sd_MPa
    screened = () if screen is None else screen.suspected
    known = screened if explained is None else explained.suspected
    p_value = None if screen is None else screen.p_value
    nominal = screen is not None and screen.p_nominal
    changing = next(
        (suspect for suspect in known if _class_of(E_MPa * suspect.E_ratio, grading) != place.maturity), None
    )
    improbable = p_value is not None and p_value < grading.inspect_below_p
    if changing is None and not improbable:
        return None
    if p_value is None and explained is not None:
        p_value, nominal = explained.p_value, explained.p_nominal is not None
    shown = changing or next(iter(known or screened), None)
    names = () if screen is None else screen.names
    with_MPa = None if shown is None else E_MPa * shown.E_ratio
    return IMPROBABLE if improbable else OTHER_CLASS, Suspicion(
        effect=shown.effect if shown is not None else "|".join(names),
        p_value=p_value,
        p_nominal=nominal,
        E_MPa=E_MPa,
        E_sd_MPa=E_sd_MPa,
        maturity=place.maturity or "",
        E_with_MPa=with_MPa,
        E_with_sd_MPa=None
        if shown is None or with_MPa is None
        else with_MPa * math.hypot(E_sd_MPa / E_MPa, shown.added_sd),
        maturity_with="" if with_MPa is None else _class_of(with_MPa, grading) or "",
    )


def _class_of(E_MPa: float, grading: Grading) -> str | None:
    return maturity(math.log(E_MPa), 0.0, grading.classes)[0]


def ship_probability(class_probabilities: Sequence[float], shipped: Sequence[bool]) -> float:
    """The probability that the true modulus is in a class that is shipped.

    >>> round(ship_probability((0.2, 0.5, 0.3), (True, True, False)), 9)
    0.7
    """
    return sum(share for share, goes in zip(class_probabilities, shipped, strict=True) if goes)


def _other_class(place: Rank, grading: Grading) -> dict[str, Any]:
    """The likeliest class other than its own, if its own is not certain, as fields of a Decision."""
    if place.maturity_probability is None or place.maturity_probability >= grading.certainty:
        return {}
    others = [
        (share, grade.name)
        for share, grade in zip(place.class_probabilities, grading.classes, strict=True)
        if grade.name != place.maturity
    ]
    share, name = max(others, default=(None, None))
    return {"other_class": name, "other_class_probability": share}
