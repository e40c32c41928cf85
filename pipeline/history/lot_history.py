"""Computes the page of a history from batches of many days: lots and reference bodies."""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from datetime import UTC, date, datetime, time, timedelta
from itertools import groupby

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from pipeline.files.plain_file import listed
from pipeline.history.appraisers import comparisons, gripper_of
from pipeline.history.lot_statistics import class_ranges, lot_statistics, out_of_control, share_outside
from pipeline.history.lots_softening import lot_groups
from pipeline.history.merged_fruit import merged_fruit
from pipeline.history.softening import COVERAGE, FARTHEST, Softening, change_per_day, reached, softening_of
from pipeline.history.stored_batch import StoredBatch, StoredFruit
from reports.entries import RatioPoint, ReferenceBodyEntry
from reports.history_entries import (
    LINE_POINTS,
    DayEntry,
    GaugeEntry,
    HistoryEntry,
    LimitEntry,
    SeriesEntry,
    SofteningEntry,
)

LOW, HIGH = 0.5 - COVERAGE / 2, 0.5 + COVERAGE / 2
"""Probabilities below an interval's ends."""
QUANTILE = float(norm.ppf(HIGH))
UNKNOWN_SPREAD = 0.15
"""Standard deviation of ln E of single fruit if a lot has no estimate: moduli of a lot differ by about 15 %.
Set by hand."""
REVISED = (
    "{batches} of its batches {were} graded again: the newest results count, and the store keeps "
    "{revisions} earlier revision{s}"
)
SAME_IDS = (
    "several batches contain the same fruit ids on each of {days}. Statistics and rate count every "
    "measurement; sampling plans and the OECD sample count one fruit per id"
)
MOST_NAMED = 6
"""Most fruit or days that one sentence names."""
MISSING = (
    "the newest results of batch {key} ({folder}) lack {names}, which earlier results contain; "
    "{they} still count{s}. To remove one from a store: --forget {key}/{first}"
)
TENTH = 0.1
"""Share of fruit for which the page states a day, beside the day of the mean."""
PRECISION = 0.05
"""Default half-width of the mean's 90 % interval, over the mean, that sets the number of fruit needed."""
DAY_OF_GRADING = "batch.toml has no measured_on for {days}, so drupe takes the day of grading"
NO_TEST = "With two days, nothing tests the exponential law; a third day does."
CHECK_DAYS = "Check temperature, sampling and sensor."
SEVERAL_LIMITS = "the batches of this lot have different class limits; drupe uses those of the last day"


def history_entry(
    batches: Sequence[StoredBatch],
    *,
    gauges: Iterable[GaugeEntry] = (),
    precision: float = PRECISION,
    now: datetime,
) -> HistoryEntry:
    """The content of the page; `precision`: half-width of the mean's 90 % interval over the mean."""
    by_series: dict[tuple[str, str, str], list[StoredBatch]] = defaultdict(list)
    for batch in sorted(batches, key=lambda batch: (batch.measured, batch.graded_utc)):
        by_series[batch.series].append(batch)
    bodies = _bodies(batches)
    series = tuple(
        series_entry(of_lot, precision=precision)
        for _, of_lot in sorted(by_series.items())
        if _fitted(of_lot)
    )
    return HistoryEntry(
        made_utc=now,
        batches=len(batches),
        series=series,
        bodies=bodies,
        alarms=tuple(_alarms(bodies)),
        groups=tuple(lot_groups(series)),
        comparisons=tuple(comparisons(batches)),
        gauges=tuple(gauges),
        precision=precision,
    )


def _fitted(batches: Iterable[StoredBatch]) -> list[StoredFruit]:
    return [fruit for batch in batches for fruit in batch.fruit if fruit.fitted]


def series_entry(batches: Sequence[StoredBatch], *, precision: float) -> SeriesEntry:
    """One lot over its days; `batches`: oldest first, at least one fruit counts."""
    by_day = {day: list(of_day) for day, of_day in groupby(batches, key=lambda batch: batch.measured)}
    first = min(by_day)
    E_MPa = {
        float((day - first).days): [fruit.E_MPa for fruit in _fitted(of_day)]
        for day, of_day in by_day.items()
    }
    law = softening_of(E_MPa, single_sd=UNKNOWN_SPREAD)
    limits = [batch.limits for batch in batches if batch.limits]
    last = batches[-1]
    return SeriesEntry(
        category=last.category,
        cultivar=last.cultivar,
        lot=last.lot,
        days=tuple(
            _day_entry(day, of_day, law, precision=precision)
            for day, of_day in by_day.items()
            if _fitted(of_day)
        ),
        softening=None if law is None else _softening_entry(law),
        softening_words=_softening_words(law),
        limits=tuple(_limits(limits[-1], law, first, E_MPa)) if limits else (),
        notes=tuple(_notes(batches, several_limits=len(set(limits)) > 1)),
    )


def _notes(batches: Sequence[StoredBatch], *, several_limits: bool) -> Iterable[str]:
    if undated := sorted({f"{batch.measured}" for batch in batches if not batch.dated}):
        yield DAY_OF_GRADING.format(days=listed(undated, MOST_NAMED))
    if several_limits:
        yield SEVERAL_LIMITS
    if twice := sorted({f"{fruit.batch.measured}" for fruit in merged_fruit(batches) if len(fruit.rows) > 1}):
        yield SAME_IDS.format(days=listed(twice, MOST_NAMED))
    if revised := [batch.revisions for batch in batches if batch.revisions]:
        yield REVISED.format(
            batches=len(revised),
            were="was" if len(revised) == 1 else "were",
            revisions=sum(revised),
            s="s" if sum(revised) > 1 else "",
        )
    for batch in batches:
        if missing := batch.missing:
            yield MISSING.format(
                key=batch.key,
                folder=batch.folder,
                names=listed(missing, MOST_NAMED),
                they="it" if len(missing) == 1 else "they",
                s="s" if len(missing) == 1 else "",
                first=missing[0],
            )


def _day_entry(
    day: date, batches: Sequence[StoredBatch], law: Softening | None, *, precision: float
) -> DayEntry:
    E_MPa = [fruit.E_MPa for fruit in _fitted(batches)]
    logs = np.log(E_MPa)
    single_sd, quantile = law.fruit_sd if law else UNKNOWN_SPREAD, QUANTILE
    if law is None and len(logs) > 1:
        single_sd, quantile = float(logs.std(ddof=1)), float(student.ppf(HIGH, len(logs) - 1))
    half = quantile * single_sd / math.sqrt(len(logs))
    low, mean, high = np.exp(logs.mean() + half * np.array([-1, 0, 1])).tolist()
    graded = sum(fruit.E_known_MPa is None for batch in batches for fruit in batch.fruit)
    temperatures = [batch.temperature_C for batch in batches if batch.temperature_C is not None]
    return DayEntry(
        day=day,
        left_out=graded + sum(len(batch.lost) for batch in batches) - len(E_MPa),
        E_MPa=mean,
        E_low_MPa=low,
        E_high_MPa=high,
        single_E_MPa=tuple(E_MPa),
        temperature_C=float(np.mean(temperatures)) if temperatures else None,
        statistics=lot_statistics(E_MPa, precision=precision),
    )


def _softening_entry(law: Softening) -> SofteningEntry:
    end = law.farthest_day if law.softens else law.last
    days = np.linspace(law.first, end, LINE_POINTS)
    return SofteningEntry(
        day=days,
        E_MPa=np.exp(law.ln_E(days)),
        E_low_MPa=np.exp(law.ln_E(days, LOW)),
        E_high_MPa=np.exp(law.ln_E(days, HIGH)),
    )


def _softening_words(law: Softening | None) -> str:
    if law is None:
        return "Only one day is measured; measure a second day to see how fast the lot softens."
    rate, low, high = law.rate(), law.rate(LOW), law.rate(HIGH)
    if not law.softens:
        words = (
            f"No softening is visible: E changes by {change_per_day(-rate):+.1f} % a day "
            f"({change_per_day(-high):+.1f} to {change_per_day(-low):+.1f} %, 90 %)."
        )
    else:
        words = (
            f"E falls by {-change_per_day(-rate):.1f} % a day "
            f"({-change_per_day(-low):.1f} to {-change_per_day(-high):.1f} %, "
            f"90 %); the half-life is {math.log(2) / rate:.1f} days."
        )
    if law.days == 2:
        words += f" {NO_TEST}"
    elif law.day_sd > law.fruit_sd:
        deviation = f"{100 * law.day_sd:.0f} %"
        words += f" Days deviate from the law by {deviation}, more than single fruit of one day. {CHECK_DAYS}"
    return words


def _limits(
    limits: Sequence[tuple[str, float | None]],
    law: Softening | None,
    first: date,
    E_MPa: dict[float, list[float]],
) -> Iterable[LimitEntry]:
    latest_day = max(day for day, fruit in E_MPa.items() if fruit)
    latest = E_MPa[latest_day]
    mean = float(np.log(latest).mean())
    for name, lower, limit in class_ranges(limits):
        if limit is None:
            continue
        below = float(np.mean(np.array(latest) <= limit))
        unknown = ""
        if law is None:
            unknown = "Not known yet; measure a second day."
        elif not law.softens:
            unknown = "Not known yet; no softening is visible."
        words = unknown
        if lower and mean <= math.log(lower):
            words = "The mean is below this class already."
        elif mean <= math.log(limit):
            words = "The mean is in this class already."
        crossed = f"Already; {100 * below:.0f} % of the fruit are at or below this limit."
        tenth_words = crossed if below >= TENTH else unknown
        yield LimitEntry(
            name=name,
            E_max_MPa=limit,
            words=words or _when(law, limit, first, share=0.5),
            tenth_words=tenth_words or _when(law, limit, first, share=TENTH),
            share_below=below,
            outside=share_outside(latest, above_MPa=lower, up_to_MPa=limit),
        )


def _when(law: Softening | None, limit_MPa: float, first: date, *, share: float) -> str:
    if law is None:
        return ""
    earliest, day, latest = reached(law, limit_MPa, share=share)
    if day is None:
        far = _on(first, law.farthest_day)
        return f"Not before {far}, the last predicted day ({FARTHEST:g} times the observed days)."
    on, since = _on(first, day), _on(first, earliest or law.first)
    left = day - law.last
    if latest is None:
        if left > 0:
            return f"In about {left:.1f} days, on {on} ({since} or later, 90 %)."
        return f"About now, on {on} ({since} or later, 90 %)."
    until = _on(first, latest)
    if left > 0:
        return f"In about {left:.1f} days, on {on} ({since} to {until}, 90 %)."
    return f"About now, on {on} ({since} to {until}, 90 %)."


def _on(first: date, day: float) -> str:
    return f"{first + timedelta(days=round(day)):%Y-%m-%d}"


def _bodies(batches: Sequence[StoredBatch]) -> tuple[ReferenceBodyEntry, ...]:
    """An entry per reference body, and per gripper if there are several, with its ratios over time."""
    grippers = {gripper_of(batch) for batch in batches}
    by_id: dict[str, list[tuple[StoredBatch, StoredFruit]]] = defaultdict(list)
    for batch in sorted(batches, key=lambda batch: (batch.measured, batch.graded_utc)):
        for fruit in batch.fruit:
            if fruit.E_known_MPa is not None:
                gripper = f", gripper {gripper_of(batch) or 'not stated'}" if len(grippers) > 1 else ""
                by_id[fruit.fruit_id + gripper].append((batch, fruit))
    entries = []
    for name, measurements in sorted(by_id.items()):
        history = tuple(_ratio_point(batch, body) for batch, body in measurements)
        _, last = measurements[-1]
        entries.append(
            ReferenceBodyEntry(
                fruit_id=name,
                E_known_MPa=last.E_known_MPa or math.nan,
                E_known_sd_MPa=last.E_known_sd_MPa or 0.0,
                E_found_MPa=last.E_MPa,
                E_found_sd_MPa=last.E_sd_MPa,
                ratio=history[-1].ratio,
                ratio_sd=history[-1].sd,
                history=history,
            )
        )
    return tuple(entries)


def _ratio_point(batch: StoredBatch, body: StoredFruit) -> RatioPoint:
    known = body.E_known_MPa or math.nan
    ratio = body.E_MPa / known
    relative = math.hypot(body.E_sd_MPa / body.E_MPa, (body.E_known_sd_MPa or 0.0) / known)
    at = datetime.combine(batch.measured, time(12), tzinfo=UTC)
    return RatioPoint(time_utc=at, lot=batch.lot, ratio=ratio, sd=ratio * relative)


def _alarms(bodies: Sequence[ReferenceBodyEntry]) -> Iterable[str]:
    for body in bodies:
        z = np.array([math.log(point.ratio) * point.ratio / point.sd for point in body.history])
        if said := out_of_control(z):
            yield f"{body.fruit_id}: {said}. Check the sensor before you grade the next batch."
