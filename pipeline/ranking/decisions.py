"""What becomes of each fruit: ship it, hold it, or inspect it.

E's error is taken as lognormal, as for the classes (pipeline.ranking.maturity): with the class limits b_k,
class k has the probability

    P_k = Phi((log b_k - log E) / s) - Phi((log b_(k-1) - log E) / s),      s = sd/E

and the fruit may be shipped with the sum of P_k over the classes that are shipped.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from fem.mismatch.screen import UNKNOWN
from pipeline.batch.records import FruitRecord
from pipeline.batch.settings import Grading
from pipeline.ranking.maturity import Rank
from reports.entries import HOLD, INSPECT, SHIP
from reports.words import percent

CERTAIN = 0.9
"""A class, and what follows from it, is certain from this probability on. Set by hand: of fruit that just
reach it one in ten is of another class."""


@dataclass(frozen=True, kw_only=True)
class Decision:
    """The list a fruit is on (SHIP, HOLD, INSPECT; empty: on none), why where it is INSPECT, and the class that
    it may have as well, with its probability, where its own is not certain.
    """

    list_name: str = ""
    why: str = ""
    other_class: str | None = None
    other_probability: float | None = None


def decide(record: FruitRecord, place: Rank | None, grading: Grading, *, mismatch: str | None) -> Decision:
    """The fruit's list; a reference body is on none, nor is a sound fruit where no class limits are set.

    `mismatch`: what is found to be missing in the model, as the report has it.
    """
    if record.given.reference:
        return Decision()
    if not record.graded or place is None:
        return Decision(list_name=INSPECT, why="not graded")
    if record.doubts:
        return Decision(list_name=INSPECT, why="E is in doubt")
    suspected = () if record.screen is None else record.screen.names
    if UNKNOWN in (mismatch, *suspected[:1]):
        return Decision(list_name=INSPECT, why="nothing known explains its recordings")
    shipped = grading.shipped
    if shipped is None:
        return Decision()
    other, probability = _other_class(place, grading)
    chance = ship_probability(place.class_probabilities, shipped)
    if 1 - CERTAIN < chance < CERTAIN:
        why = f"borderline: to be shipped with {percent(chance)}"
        return Decision(list_name=INSPECT, why=why, other_class=other, other_probability=probability)
    return Decision(
        list_name=SHIP if chance >= CERTAIN else HOLD, other_class=other, other_probability=probability
    )


def ship_probability(class_probabilities: Sequence[float], shipped: Sequence[bool]) -> float:
    """The probability that the true modulus is that of a class that is shipped.

    >>> round(ship_probability((0.2, 0.5, 0.3), (True, True, False)), 9)
    0.7
    """
    return sum(share for share, goes in zip(class_probabilities, shipped, strict=True) if goes)


def _other_class(place: Rank, grading: Grading) -> tuple[str | None, float | None]:
    """The likeliest class but its own, where that is not certain."""
    if place.maturity_probability is None or place.maturity_probability >= CERTAIN:
        return None, None
    others = [
        (share, grade.name)
        for share, grade in zip(place.class_probabilities, grading.classes, strict=True)
        if grade.name != place.maturity
    ]
    if not others:
        return None, None
    share, name = max(others)
    return name, share
