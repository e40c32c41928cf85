"""The decision on each lot of a store by a sampling plan: nonconforming fruit are those outside a class.

By attributes, each fruit is inside the class or not. By variables, ln E of the fruit is normal and the class
has one limit: the plan compares Q = (ln U - mean) / s or (mean - ln L) / s with k. A lot's sample comes from
its last day, without fruit in doubt. A fruit that two batches measured that day counts once. If there are
more fruit than the plan needs, the sample is the first n by the SHA-256 of lot, day and fruit. This draw does
not depend on E.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Float

from pipeline.history.acceptance_plans import (
    SWITCHING,
    AttributesPlan,
    NoPlan,
    SamplingPlan,
    VariablesPlan,
    attributes_plan,
    operating_characteristic,
    share_accepted_with,
    variables_plan,
)
from pipeline.history.lot_statistics import class_ranges
from pipeline.history.merged_fruit import merged_fruit
from pipeline.history.stored_batch import StoredBatch
from reports.history_entries import AcceptanceEntry, LotDecisionEntry, LotName
from reports.words import lot_words

ACCEPT, REJECT, MORE = "accept", "reject", "more fruit needed"
POINTS = (0.95, 0.5, 0.1)
"""Probabilities of acceptance at which drupe states the nonconforming fruit: producer's, even, consumer's."""


@dataclass(frozen=True, kw_only=True)
class PlanWanted:
    """Options of a plan. `lot_size`: texts "5000", or "LOT=5000" for one lot; `aql` in per cent."""

    lot_size: tuple[str, ...] = ()
    aql: float = 4.0
    level: str = "II"
    inspection: str = "normal"
    variables: bool = False

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes by lot; "": of all other lots. Raises NoPlan for an invalid text or two sizes of a lot.

        >>> PlanWanted(lot_size=("5000", "lot 7=1200")).sizes
        {'': 5000, 'lot 7': 1200}
        """
        parts = [text.rpartition("=") for text in self.lot_size]
        if wrong := [lot + mark + size for lot, mark, size in parts if not size.strip().isdecimal()]:
            raise NoPlan(f'--lot-size: found "{wrong[0]}", expected a number of fruit, or LOT=NUMBER')
        sizes: dict[str, int] = {}
        for lot, _, size in parts:
            if (name := lot.strip()) in sizes:
                named = f'lot "{name}"' if name else "lots without a size of their own"
                raise NoPlan(f"--lot-size states two sizes of {named}; remove one")
            sizes[name] = int(size)
        return sizes

    def plan(self, lot: str = "") -> SamplingPlan:
        """The plan of a lot. Raises NoPlan if its size is unknown or the tables have no such plan."""
        size = self.sizes.get(lot, self.sizes.get(""))
        if size is None:
            if lot:
                raise NoPlan(f'the size of lot "{lot}" is not stated; add --lot-size "{lot}=FRUIT"')
            raise NoPlan("the size of the lot is not stated; add --lot-size FRUIT")
        make = variables_plan if self.variables else attributes_plan
        return make(size, self.aql, level=self.level, inspection=self.inspection)


def plan_words(plan: SamplingPlan) -> tuple[str, str, str]:
    """The plan, its risks in a long series of lots, and its switching rule, as clauses."""
    return plan.words, _risks(plan), SWITCHING[plan.inspection]


def _risks(plan: SamplingPlan) -> str:
    if isinstance(plan, AttributesPlan) and plan.n >= plan.lot_size:
        return (
            f"The sample is the whole lot. The plan accepts it with at most {plan.ac} nonconforming fruit, "
            f"and rejects it with {plan.re} or more"
        )
    first, even, last = (100 * share_accepted_with(plan, probability) for probability in POINTS)
    return (
        f"The plan accepts 95 % of lots with {first:.2g} % nonconforming fruit, 50 % with {even:.2g} % and "
        f"10 % with {last:.2g} %"
    )


def acceptance_entries(
    batches: Sequence[StoredBatch], class_name: str, wanted: PlanWanted
) -> Iterator[AcceptanceEntry]:
    """An entry per plan, with its curve and the decisions on its lots. Raises NoPlan if no lot has a plan, or
    if `wanted` names a lot that no batch has.
    """
    for named in wanted.sizes:
        if named and named not in {batch.lot for batch in batches}:
            raise NoPlan(f'--lot-size names lot "{named}", which no batch has')
    decisions: dict[SamplingPlan, list[LotDecisionEntry]] = {}
    refusals: list[tuple[LotName, str]] = []
    for on_day in _last_days(batches):
        try:
            plan = wanted.plan(on_day[-1].lot)
            lot = _decision(on_day, class_name, plan)
            decisions.setdefault(plan, []).append(lot)
        except NoPlan as reason:
            refusals.append((on_day[-1].lot_day, f"{reason}"))
    if not decisions:
        reasons = (f"{lot_words(name)}: {reason}" for name, reason in refusals)
        raise NoPlan("; ".join(reasons) or "no batch has fruit")
    for plan, of_plan in decisions.items():
        words, *risks = plan_words(plan)
        yield AcceptanceEntry(
            words=words,
            risks=". ".join(risks),
            class_name=class_name,
            aql=plan.aql,
            curve=operating_characteristic(plan).to_numpy(),
            decisions=tuple(of_plan),
            refusals=tuple(refusals),
        )
        refusals = []


def _last_days(batches: Sequence[StoredBatch]) -> Iterator[list[StoredBatch]]:
    """The batches of each lot's last day, the newest last, even if no fruit of that day counts. Batches that
    contain only reference bodies are left out.
    """
    fruit = [
        batch
        for batch in batches
        if batch.lost or any(specimen.E_known_MPa is None for specimen in batch.fruit)
    ]
    for _, of_lot in groupby(sorted(fruit, key=lambda batch: batch.series), key=lambda batch: batch.series):
        days = sorted(of_lot, key=lambda batch: (batch.measured, batch.graded_utc))
        yield [batch for batch in days if batch.measured == days[-1].measured]


def _decision(on_day: Sequence[StoredBatch], class_name: str, plan: SamplingPlan) -> LotDecisionEntry:
    ranges = {name: (low, high) for name, low, high in class_ranges(on_day[-1].limits)}
    if class_name not in ranges:
        known = ", ".join(ranges) or "none"
        raise NoPlan(f'batch.toml has no class "{class_name}"; its classes: {known}')
    low, high = ranges[class_name]
    fruit = {specimen.fruit_id: specimen.E_MPa for specimen in merged_fruit(on_day)}
    drawn = sorted(fruit, key=lambda name: _place(on_day[-1], name))[: plan.n]
    E_MPa = np.array([fruit[name] for name in drawn])
    top = math.inf if high is None else high
    if isinstance(plan, AttributesPlan):
        verdict, words = _by_attributes(plan, E_MPa, low, top)
    else:
        verdict, words = _by_variables(plan, E_MPa, low, top)
    sentences = [words]
    if len(fruit) > plan.n:
        sentences.append(f"The sample is {plan.n} of the {len(fruit)} fruit, drawn without regard to E")
    sentences += _left_out(on_day, set(fruit))
    return LotDecisionEntry(name=on_day[-1].lot_day, verdict=verdict, words=". ".join(sentences))


def _place(batch: StoredBatch, fruit_id: str) -> str:
    return hashlib.sha256(f"{batch.lot}\n{batch.measured}\n{fruit_id}".encode()).hexdigest()


def _left_out(on_day: Sequence[StoredBatch], counted: set[str]) -> Iterator[str]:
    """Clauses with the number of the day's fruit that no batch counts."""
    doubted = {
        fruit.fruit_id
        for batch in on_day
        for fruit in batch.fruit
        if fruit.doubted and fruit.E_known_MPa is None
    }
    lost = {name for batch in on_day for name in batch.lost}
    if in_doubt := len(doubted - counted):
        yield f"drupe left out {in_doubt} fruit in doubt"
    if not_graded := len(lost - doubted - counted):
        yield f"drupe left out {not_graded} fruit without a grade"


def _by_attributes(plan: AttributesPlan, E_MPa: np.ndarray, low: float, high: float) -> tuple[str, str]:
    outside = int(np.sum((E_MPa <= low) | (E_MPa > high)))
    words = f"{outside} of {len(E_MPa)} fruit are outside the class"
    if outside >= plan.re:
        return REJECT, words
    if len(E_MPa) < plan.n:
        return MORE, f"{words}; the plan needs {plan.n} fruit: grade {plan.n - len(E_MPa)} more"
    if outside > plan.ac:
        words += ". That is between Ac and Re: return to normal inspection for the next lot"
    return ACCEPT, words


def _by_variables(plan: VariablesPlan, E_MPa: np.ndarray, low: float, high: float) -> tuple[str, str]:
    upper = math.isfinite(high)
    if (low > 0) == upper:
        limits = "has two limits" if upper else "has no limit"
        raise NoPlan(f"a plan by variables needs a class with one limit, and this one {limits}")
    if (fruit := len(E_MPa)) < plan.n:
        return MORE, f"{fruit} fruit are measured; the plan needs {plan.n}: grade {plan.n - fruit} more"
    Q = quality_index(np.log(E_MPa), limit=math.log(high if upper else low), upper=upper)
    if plan.k <= Q:
        return ACCEPT, f"Q = {Q:.4g} of ln E is at least k = {plan.k:g}"
    return REJECT, f"Q = {Q:.4g} of ln E is below k = {plan.k:g}"


def quality_index(values: Float[np.ndarray, " n"], *, limit: float, upper: bool) -> float:
    """Distance of the mean inside the limit, in standard deviations (n - 1). Raises NoPlan below 2 values.

    >>> round(quality_index(np.array([197.0, 188.0, 184.0, 205.0, 201.0]), limit=209.0, upper=True), 2)
    1.59
    """
    if len(values) < 2:
        raise NoPlan(f"found {len(values)} fruit, expected at least 2 for a plan by variables")
    inside = (limit - values.mean()) * (1 if upper else -1)
    sd = values.std(ddof=1)
    return float(inside / sd) if sd > 0 else math.copysign(math.inf, inside)
