"""Fits readings of a penetrometer (the user's columns of fruits.csv) to E.

    F = a + b E + e        or        ln F = a + b ln E + e

drupe fits both laws by least squares to the fruit of one cultivar over all lots of the store. It keeps the
law with the smaller leave-one-out error in N (Allen, Technometrics 16, 1974, 125: residual over
1 - leverage). This fit also gives the prediction interval of a new fruit. E is a modulus at small load, but a
plunger breaks flesh: drupe states the share of variance that E explains, and never converts without a fit.
Relations differ between cultivars and seasons (Int. Agrophys. 14, 2000, 311). Plungers of 8 and 11.1 mm have
separate fits, because force does not scale with their area.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from pipeline.batch.firmness_columns import PLUNGERS_MM, predicted_columns
from pipeline.history.merged_fruit import merged_fruit
from pipeline.history.softening import COVERAGE
from pipeline.history.stored_batch import StoredBatch, StoredFruit
from reports.history_entries import LINE_POINTS, FirmnessEntry, LotName

FEWEST_FRUIT = 8
"""Fewest fruit with E and a reading for a fit: Student's t is 1.94 with six degrees of freedom, a fifth more
than with many. Set by hand."""
LEAST_SPAN = 0.4
"""Least range of ln E of the fruit, a factor of 1.5 in E; over less, a line fits noise. Set by hand."""
UNITS = {"N": 1.0, "kgf": 9.80665, "lbf": 4.4482216152605}
"""Newtons per unit (BIPM, NIST SP 811)."""
COLUMN = re.compile(r"(?P<column>.+)=\s*(?P<unit>[A-Za-z]+)\s*@(?P<plunger>[^=@]+)")
OWN_SCALE = "penetrometer_N"
"""A column that drupe defines, in N."""


class NoReading(ValueError):
    """A text names no column of readings; the message is a sentence with the reason."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A column of fruits.csv with readings of a penetrometer; `newtons`: N per unit of the column."""

    column: str
    newtons: float
    plunger_mm: float

    def of(self, fruit: StoredFruit) -> float | None:
        """The fruit's reading, N; None for an empty cell, NaN for text and numbers not above 0."""
        cell = fruit.penetrometer_N if self.column == OWN_SCALE else fruit.columns.get(self.column)
        if cell is None or cell == "":
            return None
        return float(cell) * self.newtons if isinstance(cell, int | float) and cell > 0 else math.nan


def reading_of(text: str) -> Reading:
    """The column that a text COLUMN=UNIT@PLUNGER names. Raises NoReading for another text.

    >>> one = reading_of("cheek 1=kgf@5/16 in")
    >>> one.column, round(one.newtons, 5), one.plunger_mm
    ('cheek 1', 9.80665, 8.0)
    """
    match = COLUMN.fullmatch(text)
    if match is None:
        raise NoReading(f'found "{text}", expected COLUMN=UNIT@PLUNGER, for example "cheek 1=kgf@11.1mm"')
    unit = match["unit"]
    if unit not in UNITS:
        raise NoReading(f'found the unit "{unit}", expected a force: {", ".join(UNITS)}')
    plunger_mm = PLUNGERS_MM.get(match["plunger"].replace(" ", ""))
    if plunger_mm is None:
        found_size, known = match["plunger"].strip(), ", ".join(PLUNGERS_MM)
        raise NoReading(f'found a plunger of "{found_size}", expected one of {known}')
    if match["column"].strip() == OWN_SCALE and unit != "N":
        wanted = f"{OWN_SCALE}=N@{match['plunger'].strip()}"
        raise NoReading(f'found "{text}", but the column {OWN_SCALE} is in N; write "{wanted}"')
    return Reading(column=match["column"].strip(), newtons=UNITS[unit], plunger_mm=plunger_mm)


@dataclass(frozen=True, kw_only=True)
class FirmnessRelation:
    """The fitted law; `power`: the logarithmic one. `fit`: of statsmodels. `error_N`: leave-one-out error
    (rms). `explained`: share of the readings' variance that leave-one-out predictions explain.
    """

    power: bool
    fit: Any
    E_low_MPa: float
    E_high_MPa: float
    error_N: float
    explained: float

    def predicted(self, E_MPa: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 3"]:
        """The predicted reading of a new fruit with each E, and both ends of its 90 % interval, N."""
        frame = self.fit.get_prediction(_design(E_MPa, self.power)).summary_frame(alpha=1 - COVERAGE)
        cells = frame[["mean", "obs_ci_lower", "obs_ci_upper"]].to_numpy()
        return np.asarray(np.exp(cells) if self.power else np.maximum(cells, 0.0))

    @property
    def words(self) -> str:
        """The law as an equation, with its scatter."""
        a, b = self.fit.params
        law = f"{a:.3g} N {'+' if b >= 0 else '-'} {abs(b):.3g} N/MPa E"
        if self.power:
            law = f"{np.exp(a):.3g} N (E / MPa)^{b:.3g}"
        return (
            f"F = {law}, fitted to {self.fit.nobs:.0f} fruit of {self.E_low_MPa:.3g} to "
            f"{self.E_high_MPa:.3g} MPa. Left-out readings differ from it by {self.error_N:.2g} N (rms); it "
            f"explains {100 * self.explained:.0f} % of their variance"
        )


def _design(E_MPa: Float[np.ndarray, " n"], power: bool) -> Float[np.ndarray, "n 2"]:
    return np.stack([np.ones_like(E_MPa), np.log(E_MPa) if power else E_MPa], axis=1)


def _law(E_MPa: Float[np.ndarray, " n"], F: Float[np.ndarray, " n"], power: bool) -> FirmnessRelation:
    from statsmodels.regression.linear_model import OLS

    fit = OLS(np.log(F) if power else F, _design(E_MPa, power)).fit()
    left_out = fit.get_influence().resid_press
    error = F - np.exp(np.log(F) - left_out) if power else left_out
    spread = float(np.sum((F - (F.sum() - F) / (len(F) - 1)) ** 2))  # from the mean of all others
    return FirmnessRelation(
        power=power,
        fit=fit,
        E_low_MPa=float(E_MPa.min()),
        E_high_MPa=float(E_MPa.max()),
        error_N=float(np.sqrt(np.mean(error**2))),
        explained=1 - float(np.sum(error**2)) / spread if spread > 0 else 0.0,
    )


def firmness_relation(
    E_MPa: Float[np.ndarray, " n"], reading_N: Float[np.ndarray, " n"]
) -> FirmnessRelation | str:
    """The law with the smaller leave-one-out error; else a clause that states why there is none."""
    if len(E_MPa) < FEWEST_FRUIT:
        return f"{len(E_MPa)} fruit have both E and a reading; the fit needs at least {FEWEST_FRUIT}"
    if (span := float(np.ptp(np.log(E_MPa)))) < LEAST_SPAN:
        return (
            f"E of the {len(E_MPa)} fruit spans a factor of {np.exp(span):.2f}; the fit needs at least "
            f"{np.exp(LEAST_SPAN):.2f}: add riper or firmer fruit"
        )
    best = min((_law(E_MPa, reading_N, power) for power in (False, True)), key=lambda law: law.error_N)
    if best.explained <= 0:
        return f"E predicts left-out readings of the {len(E_MPa)} fruit no better than their mean does"
    return best


Key = tuple[LotName, float]
"""A cultivar (StoredBatch.group), and the plunger in mm."""


def firmness_relations(
    batches: Sequence[StoredBatch], readings: Sequence[Reading]
) -> Iterator[tuple[Key, FirmnessEntry, FirmnessRelation | None]]:
    """The relation of each cultivar and plunger with readings; averages the readings (cheeks) of a fruit.
    Raises NoReading if no fruit has a reading in a column.
    """
    pairs: dict[Key, list[tuple[float, float]]] = defaultdict(list)
    left_out: Counter[Key] = Counter()
    usable, unusable = Counter[Reading](), Counter[Reading]()
    for fruit in merged_fruit(batches):
        of_plunger: dict[Key, list[float]] = defaultdict(list)
        for reading in readings:
            key = fruit.batch.group, reading.plunger_mm
            cells = [force for row in fruit.rows if (force := reading.of(row)) is not None]
            valid = [force for force in cells if not math.isnan(force)]
            of_plunger[key] += [float(np.mean(valid))] if valid else []
            left_out[key] += len(cells) - len(valid)
            usable[reading] += len(valid)
            unusable[reading] += len(cells) - len(valid)
        for key, forces in of_plunger.items():
            if forces:
                pairs[key].append((fruit.E_MPa, float(np.mean(forces))))
    _require_readings(readings, usable, unusable)
    for (group, plunger_mm), both in sorted(pairs.items()):
        E, F = np.array(both).T
        relation = firmness_relation(E, F)
        entry = partial(FirmnessEntry, name=group, plunger_mm=plunger_mm, E_MPa=E, reading_N=F)
        count = left_out[group, plunger_mm]
        added = f"drupe left out {count} cells with text or a number not above 0" if count else ""
        if isinstance(relation, str):
            words = ". ".join(filter(None, (f"not fitted: {relation}", added)))
            yield (group, plunger_mm), entry(words=words), None
            continue
        at = np.linspace(E.min(), E.max(), LINE_POINTS)
        line = np.column_stack([at, relation.predicted(at)])
        words = ". ".join(filter(None, (relation.words, added)))
        yield (group, plunger_mm), entry(words=words, line=line), relation


def _require_readings(
    readings: Sequence[Reading], usable: Mapping[Reading, int], unusable: Mapping[Reading, int]
) -> None:
    for reading in readings:
        if usable.get(reading):
            continue
        why = "check its name"
        if cells := unusable.get(reading):
            why = f"its {cells} cells have text or a number not above 0"
        raise NoReading(f'no fruit has a reading in the column "{reading.column}" of --firmness; {why}')


def with_firmness(
    table: pd.DataFrame, batches: Sequence[StoredBatch], relations: Mapping[Key, FirmnessRelation]
) -> pd.DataFrame:
    """The table of fruit with predicted readings and their 90 % intervals, within the fitted range of E."""
    rows = [(batch.group, fruit) for batch in batches for fruit in batch.fruit]
    for (group, plunger_mm), relation in sorted(relations.items()):
        cells = np.full((len(rows), 3), np.nan)
        for k, (of_fruit, fruit) in enumerate(rows):
            cells[k, 0] = fruit.E_MPa if of_fruit == group and fruit.E_known_MPa is None else np.nan
        known = (cells[:, 0] >= relation.E_low_MPa) & (cells[:, 0] <= relation.E_high_MPa)
        cells[known], cells[~known] = relation.predicted(cells[known, 0]).round(2), np.nan
        for column, name in zip(cells.T, predicted_columns(plunger_mm), strict=True):
            added = pd.Series(column, dtype=object)
            table[name] = table[name].combine_first(added) if name in table else added
    return table
