"""First screen of a report: number of fruit per class, and which fruit to ship, hold or inspect, and why."""

from __future__ import annotations

import re
from collections import Counter
from typing import NamedTuple

from reports.entries import HOLD, INSPECT, SHIP, BatchEntry, FruitEntry, ShoreCorrelation, Suspicion, ranked
from reports.language import decimals, say
from reports.words import NO_BREAK, advice, percent, suspicion_words

Indexed = tuple[int, FruitEntry]
"""A fruit with its number on the page."""
SHIPPED_WITH = "ship with probability "
"""This text precedes the probability in the reason of a borderline fruit."""
REASONS = (
    "not graded",
    "E is in doubt",
    "no known effect explains its recordings",
    "missing physics suspected",
    "the suspected effect changes its class",
    "borderline",
)
"""Every reason starts with one of these; the words files translate each of them."""
MOST_LISTED = 120
"""A printed certificate lists the fruit of a group up to this number; more do not fit on its page."""
MOST_LINKED = 12
"""The screen links to at most this many fruit of a group; the table holds all."""


class DecisionList(NamedTuple):
    """One of the three lists: its key, title, criterion (`words`), and its fruit grouped by reason."""

    key: str
    title: str
    words: str
    groups: tuple[tuple[str, tuple[Indexed, ...]], ...]

    @property
    def fruits(self) -> tuple[Indexed, ...]:
        """All fruit of the list."""
        return tuple(fruit for _, group in self.groups for fruit in group)


class Failures(NamedTuple):
    """Fruit with one outcome and advice, none of them graded: the outcome's code, its advice, the fruit."""

    outcome: str
    advice: str
    fruits: tuple[Indexed, ...]
    same_reason: str
    """The first fruit's reason if the reasons differ only in numbers and fruit ids; else empty."""


def decision_lists(batch: BatchEntry, fruits: list[Indexed]) -> tuple[DecisionList, ...]:
    """The lists ship, hold and inspect; if no class states what to ship, only a non-empty inspect list."""
    by_list: dict[str, list[Indexed]] = {SHIP: [], HOLD: [], INSPECT: []}
    for fruit in fruits:
        if fruit[1].decision:
            by_list[fruit[1].decision].append(fruit)
    shown = say(" or ").join(batch.ships or ()) or say("of a class that is shipped")
    share = share_words(batch.certainty)
    parted = batch.ships is not None
    titles = (
        (SHIP, say("Ship"), say("certainly ({share} or more) {classes}", share=share, classes=shown)),
        (HOLD, say("Hold"), say("certainly ({share} or more) not {classes}", share=share, classes=shown)),
        (
            INSPECT,
            say("Inspect"),
            say("not graded, E in doubt, missing physics suspected, or borderline"),
        ),
    )
    return tuple(
        DecisionList(key, title, words, _by_reason(by_list[key]))
        for key, title, words in titles
        if parted or (key == INSPECT and by_list[key])
    )


def _by_reason(fruits: list[Indexed]) -> tuple[tuple[str, tuple[Indexed, ...]], ...]:
    """Groups of fruit with the same reason, largest first; a borderline fruit's percentage is ignored."""
    groups: dict[str, list[Indexed]] = {}
    for fruit in fruits:
        groups.setdefault(fruit[1].decision_reason.partition(":")[0], []).append(fruit)
    return tuple(
        (reason, tuple(group)) for reason, group in sorted(groups.items(), key=lambda item: -len(item[1]))
    )


def failures(fruits: list[Indexed]) -> tuple[Failures, ...]:
    """Groups of fruit that were not graded, by outcome and advice, largest first."""
    groups: dict[tuple[str, str], list[Indexed]] = {}
    for index, fruit in fruits:
        if not fruit.ok:
            groups.setdefault((fruit.outcome, advice(fruit)), []).append((index, fruit))
    failed_groups = []
    for (outcome, what_to_do), group in groups.items():
        plain = {re.sub(r"\d+(\.\d+)?", "#", fruit.reason.replace(fruit.fruit_id, "@")) for _, fruit in group}
        same = group[0][1].reason if len(plain) == 1 else ""
        failed_groups.append(Failures(outcome, what_to_do, tuple(group), same))
    return tuple(sorted(failed_groups, key=lambda failure: -len(failure.fruits)))


def share_words(share: float) -> str:
    """A share in percent, with at most four significant digits.

    >>> share_words(0.9).replace(NO_BREAK, " "), share_words(0.995).replace(NO_BREAK, " ")
    ('90 %', '99.5 %')
    """
    return f"{decimals(f'{100 * share:.4g}')}{NO_BREAK}%"


def class_counts(batch: BatchEntry, fruits: list[Indexed]) -> tuple[tuple[str, int, int], ...]:
    """(class, number of fruit, number of uncertain fruit) of every class, softest first."""
    alone = [fruit for _, fruit in fruits if fruit.maturity]
    counts = Counter(fruit.maturity for fruit in alone)
    unsure = Counter(fruit.maturity for fruit in alone if fruit.other_class)
    return tuple((name, counts[name], unsure[name]) for name, _ in batch.classes)


def class_words(fruit: FruitEntry) -> str:
    """A borderline fruit's other possible class with its probability; empty if its class is certain."""
    if not fruit.other_class:
        return ""
    chance = percent(fruit.other_class_probability)
    return say("or {name} ({chance})", name=fruit.other_class, chance=chance)


def reason_words(reason: str, suspicion: Suspicion | None = None) -> str:
    """Why staff must inspect a fruit (pipeline.ranking.decisions), in the page's language."""
    head, colon, rest = reason.partition(": ")
    if suspicion is not None:
        return f"{say(head)}: {suspicion_words(suspicion)}"
    chance = rest.removeprefix(SHIPPED_WITH)
    if colon and chance != rest:
        return f"{say(head)}: {say('ship with probability {chance}', chance=chance)}"
    return say(reason)


def numbered(batch: BatchEntry) -> list[Indexed]:
    """All fruit as `ranked`, with the numbers that the page's links use."""
    return list(enumerate(ranked(batch.fruits), start=1))


def correlation_words(shore: ShoreCorrelation) -> str:
    """Number of fruit, both correlations of E and Shore readings, and p (if known), in one line."""
    words = say(
        "{count} fruit with both: Spearman rank correlation {spearman}, Pearson correlation {pearson}",
        count=shore.n,
        spearman=decimals(f"{shore.spearman:.2f}"),
        pearson=decimals(f"{shore.pearson:.2f}"),
    )
    if shore.p is None:
        return words
    p = f"<{NO_BREAK}0.001" if shore.p < 0.001 else f"={NO_BREAK}{shore.p:.3f}"
    return f"{words}, p{NO_BREAK}{decimals(p)}"
