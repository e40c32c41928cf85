"""The decision on each lot of a store by a sampling plan: nonconforming fruit are those outside a class.

By attributes each fruit is inside the class or not. By variables, ln E of the fruit is taken as normal, and
the class must have one limit: Q = (ln U - mean) / s or (mean - ln L) / s is compared with k. A lot's sample
is of its last day, without fruit in doubt. Where there are more fruit than the plan needs, the sample is the
first n by the SHA-256 of lot, day and fruit: a draw that does not depend on E.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Float

from pipeline.history.acceptance_plans import (
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
from pipeline.history.stored_batch import StoredBatch
from reports.history_entries import AcceptanceEntry, LotDecisionEntry

ACCEPT, REJECT, MORE = "accept", "reject", "more fruit needed"
POINTS = (0.95, 0.5, 0.1)
"""Probabilities of acceptance whose nonconforming fruit are stated: producer's, even, consumer's."""


@dataclass(frozen=True, kw_only=True)
class PlanWanted:
    """Options of a plan. `lot_size`: texts "5000", or "LOT=5000" for one lot."""

    lot_size: tuple[str, ...] = ()
    aql: float = 4.0
    level: str = "II"
    inspection: str = "normal"
    variables: bool = False

    @property
    def sizes(self) -> dict[str, int]:
        """Fruit by lot; "" for lots without a size of their own. Raises NoPlan.

        >>> PlanWanted(lot_size=("5000", "lot 7=1200")).sizes
        {'': 5000, 'lot 7': 1200}
        """
        parts = [text.rpartition("=") for text in self.lot_size]
        if wrong := [lot + mark + size for lot, mark, size in parts if not size.strip().isdecimal()]:
            raise NoPlan(f'--lot-size: found "{wrong[0]}", expected a number of fruit, or LOT=NUMBER')
        return {lot.strip(): int(size) for lot, _, size in parts}

    def plan(self, lot: str = "") -> SamplingPlan:
        """Of a lot. Raises NoPlan."""
        size = self.sizes.get(lot, self.sizes.get(""))
        if size is None:
            raise NoPlan(f'the size of lot "{lot}" is not stated; add --lot-size "{lot}=FRUIT"')
        make = variables_plan if self.variables else attributes_plan
        return make(size, self.aql, level=self.level, inspection=self.inspection)


def plan_words(plan: SamplingPlan) -> tuple[str, str]:
    """The plan, and its risks."""
    first, *others = (
        f"{100 * share_accepted_with(plan, probability):.2g} % nonconforming fruit in {100 * probability:g} %"
        for probability in POINTS
    )
    return plan.words, f"This plan accepts lots with {first} of cases, with {' and with '.join(others)}"


def acceptance_entries(
    batches: Sequence[StoredBatch], class_name: str, wanted: PlanWanted
) -> Iterator[AcceptanceEntry]:
    """A plan each, with its curve and the decisions on its lots. Raises NoPlan where no lot has one."""
    decisions: dict[SamplingPlan, list[LotDecisionEntry]] = {}
    refusals = []
    for on_day in _last_days(batches):
        try:
            plan = wanted.plan(on_day[-1].lot)
            lot = _decision(on_day, class_name, plan)
            decisions.setdefault(plan, []).append(lot)
        except NoPlan as reason:
            refusals.append(f"{_name(on_day[-1])}: {reason}")
    if not decisions:
        raise NoPlan("; ".join(refusals) or "no batch has a fruit that counts")
    for plan, of_plan in decisions.items():
        words, risks = plan_words(plan)
        yield AcceptanceEntry(
            words=words,
            risks=risks,
            class_name=class_name,
            aql=plan.aql,
            curve=operating_characteristic(plan).to_numpy(),
            decisions=tuple(of_plan),
            refusals=tuple(refusals),
        )
        refusals = []


def _last_days(batches: Sequence[StoredBatch]) -> Iterator[list[StoredBatch]]:
    """Batches with fruit that count, of each lot's last day; the newest last."""
    counted = [batch for batch in batches if any(fruit.fitted for fruit in batch.fruit)]
    for _, of_lot in groupby(sorted(counted, key=lambda batch: batch.series), key=lambda batch: batch.series):
        days = sorted(of_lot, key=lambda batch: (batch.measured, batch.graded_utc))
        yield [batch for batch in days if batch.measured == days[-1].measured]


def _name(batch: StoredBatch) -> str:
    lot = f"lot {batch.lot}" if batch.lot else "without a lot"
    return f"{batch.group}, {lot}, {batch.measured}"


def _decision(on_day: Sequence[StoredBatch], class_name: str, plan: SamplingPlan) -> LotDecisionEntry:
    ranges = {name: (low, high) for name, low, high in class_ranges(on_day[-1].limits)}
    if class_name not in ranges:
        known = ", ".join(ranges) or "none"
        raise NoPlan(f'batch.toml has no class "{class_name}"; its classes: {known}')
    low, high = ranges[class_name]
    fruit = [
        (hashlib.sha256(f"{batch.lot}\n{batch.measured}\n{one.fruit_id}".encode()).hexdigest(), one.E_MPa)
        for batch in on_day
        for one in batch.fruit
        if one.fitted
    ]
    E_MPa = np.array([E for _, E in sorted(fruit)[: plan.n]])
    top = math.inf if high is None else high
    if isinstance(plan, AttributesPlan):
        verdict, words = _by_attributes(plan, E_MPa, low, top)
    else:
        verdict, words = _by_variables(plan, E_MPa, low, top)
    if len(fruit) > plan.n:
        words += f". The sample is {plan.n} of the {len(fruit)} fruit, drawn without regard to E"
    return LotDecisionEntry(name=_name(on_day[-1]), verdict=verdict, words=words)


def _by_attributes(plan: AttributesPlan, E_MPa: np.ndarray, low: float, high: float) -> tuple[str, str]:
    outside = int(np.sum((E_MPa <= low) | (E_MPa > high)))
    words = f"{outside} of {len(E_MPa)} fruit are outside the class"
    if outside >= plan.re:
        return REJECT, words
    if len(E_MPa) < plan.n:
        return MORE, f"{words}; the plan needs {plan.n} fruit: grade {plan.n - len(E_MPa)} more"
    if outside > plan.ac:
        words += ", between Ac and Re: return to normal inspection for the next lot"
    return ACCEPT, words


def _by_variables(plan: VariablesPlan, E_MPa: np.ndarray, low: float, high: float) -> tuple[str, str]:
    upper = math.isfinite(high)
    if (low > 0) == upper:
        found = "has two limits" if upper else "has no limit"
        raise NoPlan(f"a plan by variables needs a class with one limit, and this one {found}")
    if (fruit := len(E_MPa)) < plan.n:
        return MORE, f"{fruit} fruit are measured; the plan needs {plan.n}: grade {plan.n - fruit} more"
    Q = quality_index(np.log(E_MPa), limit=math.log(high if upper else low), upper=upper)
    verdict, how = (ACCEPT, "at least") if plan.k <= Q else (REJECT, "below")
    return verdict, f"Q = {Q:.4g} of ln E, {how} k = {plan.k:g}"


def quality_index(values: Float[np.ndarray, " n"], *, limit: float, upper: bool) -> float:
    """Standard deviations (n - 1) by which the mean of at least two values lies inside the limit.

    >>> round(quality_index(np.array([197.0, 188.0, 184.0, 205.0, 201.0]), limit=209.0, upper=True), 2)
    1.59
    """
    inside = (limit - values.mean()) * (1 if upper else -1)
    sd = values.std(ddof=1)
    return float(inside / sd) if sd > 0 else math.copysign(math.inf, inside)
