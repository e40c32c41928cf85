"""Batches of many days as the entries of one page: lots, reference bodies, conversions."""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from datetime import UTC, date, datetime, time, timedelta

import numpy as np
from scipy.stats import norm

from pipeline.batch.control_chart import out_of_control
from pipeline.history.scale_conversion import ScaleConversion
from pipeline.history.softening import COVERAGE, FARTHEST, Softening, reached, softening_of
from pipeline.history.stored_batch import StoredBatch, StoredFruit
from reports.entries import RatioPoint, ReferenceBodyEntry
from reports.history_entries import (
    ConversionEntry,
    DayEntry,
    HistoryEntry,
    LimitEntry,
    SeriesEntry,
    SofteningEntry,
)

LOW, HIGH = 0.5 - COVERAGE / 2, 0.5 + COVERAGE / 2
"""Shares of probability below an interval's ends."""
QUANTILE = float(norm.ppf(HIGH))
BAND_POINTS = 60
"""Points of a drawn line: one in 14 px of the widest chart."""
UNKNOWN_SPREAD = 0.15
"""Standard deviation of ln E of single fruit of a lot where none was measured: moduli of a lot differ by some
15 %. Set by hand."""
REVISED = (
    "{batches} of its batches {were} graded again: the newest results count, and the store keeps "
    "{revisions} earlier revision{s}"
)
MOST_NAMED = 6
"""Fruit that one sentence names."""
MISSING = (
    "the newest results of batch {key} ({folder}) lack {names}, which earlier results contain; "
    "{they} still count{s}. To remove one from a store: --forget {key}/{first}"
)
SEVERAL_LIMITS = "the batches of this lot have different class limits; drupe uses those of the last day"


def history_entry(
    batches: Sequence[StoredBatch],
    *,
    conversions: Sequence[ScaleConversion],
    used: Iterable[ScaleConversion] = (),
    now: datetime,
) -> HistoryEntry:
    """All that the page says. `used`: the conversions that were asked for."""
    by_series: dict[tuple[str, str, str], list[StoredBatch]] = defaultdict(list)
    for batch in sorted(batches, key=lambda one: (one.measured, one.graded_utc)):
        by_series[batch.series].append(batch)
    bodies = _bodies(batches)
    asked = set(used)
    return HistoryEntry(
        made_utc=now,
        batches=len(batches),
        series=tuple(series_entry(own) for _, own in sorted(by_series.items()) if any(map(fruit_of, own))),
        bodies=bodies,
        alarms=tuple(_alarms(bodies)),
        conversions=tuple(_conversion_entry(one, used=one in asked) for one in conversions),
    )


def fruit_of(batch: StoredBatch) -> list[StoredFruit]:
    """Fruit that are fitted: no reference bodies, nothing in doubt."""
    return [one for one in batch.fruit if one.E_known_MPa is None and not one.doubted]


def series_entry(batches: Sequence[StoredBatch]) -> SeriesEntry:
    """One lot over its days; `batches` oldest first."""
    by_day: dict[date, list[StoredBatch]] = defaultdict(list)
    for batch in batches:
        by_day[batch.measured].append(batch)
    first = min(by_day)
    E_MPa = {
        float((day - first).days): [one.E_MPa for batch in own for one in fruit_of(batch)]
        for day, own in by_day.items()
    }
    law = softening_of(E_MPa, single_sd=UNKNOWN_SPREAD)
    limits = [one.limits for one in batches if one.limits]
    last = batches[-1]
    return SeriesEntry(
        category=last.category,
        cultivar=last.cultivar,
        lot=last.lot,
        days=tuple(
            _day_entry(day, own, law) for day, own in sorted(by_day.items()) if any(map(fruit_of, own))
        ),
        softening=None if law is None else _softening_entry(law),
        why_no_softening=""
        if law is not None
        else "one day is available; a second day shows how fast the lot softens",
        limits=tuple(_limits(limits[-1], law, first, E_MPa)) if limits else (),
        notes=tuple(_notes(batches, limits)),
    )


def _notes(
    batches: Sequence[StoredBatch], limits: Sequence[tuple[tuple[str, float | None], ...]]
) -> Iterable[str]:
    if len(set(limits)) > 1:
        yield SEVERAL_LIMITS
    if revised := [one.revisions for one in batches if one.revisions]:
        yield REVISED.format(
            batches=len(revised),
            were="was" if len(revised) == 1 else "were",
            revisions=sum(revised),
            s="s" if sum(revised) > 1 else "",
        )
    for one in batches:
        if missing := one.missing:
            more = len(missing) - MOST_NAMED
            yield MISSING.format(
                key=one.key,
                folder=one.folder,
                names=", ".join(missing[:MOST_NAMED]) + (f" and {more} more" if more > 0 else ""),
                they="it" if len(missing) == 1 else "they",
                s="s" if len(missing) == 1 else "",
                first=missing[0],
            )


def _day_entry(day: date, batches: Sequence[StoredBatch], law: Softening | None) -> DayEntry:
    fruit = [one for batch in batches for one in fruit_of(batch)]
    logs = np.log([one.E_MPa for one in fruit])
    single_sd = law.fruit_sd if law else (float(logs.std(ddof=1)) if len(logs) > 1 else UNKNOWN_SPREAD)
    mean, half = float(logs.mean()), QUANTILE * single_sd / math.sqrt(len(logs))
    everyone = sum(
        sum(one.E_known_MPa is None for one in b.fruit) + b.not_graded + len(b.lost) for b in batches
    )
    temperatures = [one.temperature_C for one in batches if one.temperature_C is not None]
    return DayEntry(
        day=day,
        fruit=len(fruit),
        left_out=everyone - len(fruit),
        E_MPa=math.exp(mean),
        E_low_MPa=math.exp(mean - half),
        E_high_MPa=math.exp(mean + half),
        single_E_MPa=tuple(one.E_MPa for one in fruit),
        temperature_C=float(np.mean(temperatures)) if temperatures else None,
    )


def _softening_entry(law: Softening) -> SofteningEntry:
    end = law.farthest_day if law.softens else law.last
    days = np.linspace(law.first, end, BAND_POINTS)
    rate, low, high = law.rate(), law.rate(LOW), law.rate(HIGH)
    if not law.softens:
        changes = f"{_per_day(-rate):+.1f} % a day ({_per_day(-high):+.1f} to {_per_day(-low):+.1f} %, 90 %)"
        words = f"No softening is visible: E changes by {changes}."
    else:
        falls = f"{-_per_day(-rate):.1f} % a day ({-_per_day(-low):.1f} to {-_per_day(-high):.1f} %, 90 %)"
        words = f"E falls by {falls}; the half-life is {math.log(2) / rate:.1f} days."
    if law.days == 2:
        words += " With two days, nothing tests the exponential law; a third day does."
    elif law.day_sd > law.fruit_sd:
        words += (
            f" Days deviate from the law by {100 * law.day_sd:.0f} %, more than single fruit of one "
            "day. Check temperature, sampling and sensor."
        )
    return SofteningEntry(
        words=words,
        day=days,
        E_MPa=np.exp(law.ln_E(days)),
        E_low_MPa=np.exp(law.ln_E(days, LOW)),
        E_high_MPa=np.exp(law.ln_E(days, HIGH)),
    )


def _per_day(rate: float) -> float:
    """By how many per cent a rate of ln E changes E in a day.

    >>> round(_per_day(-0.10536), 1)
    -10.0
    """
    return 100 * math.expm1(rate)


def _limits(
    limits: Sequence[tuple[str, float | None]],
    law: Softening | None,
    first: date,
    E_MPa: dict[float, list[float]],
) -> Iterable[LimitEntry]:
    latest_day = max(day for day, fruit in E_MPa.items() if fruit)
    latest = E_MPa[latest_day]
    mean = float(np.log(latest).mean())
    for name, limit in limits:
        if limit is None:
            continue
        below = sum(one <= limit for one in latest) / len(latest)
        if mean <= math.log(limit):
            words = "The mean is in this class already."
        elif law is None:
            words = "Unknown yet: a second day is needed."
        elif not law.softens:
            words = "Unknown yet: no softening is visible."
        else:
            words = _when(law, limit, first)
        yield LimitEntry(name=name, E_max_MPa=limit, words=words, share_below=below)


def _when(law: Softening, limit_MPa: float, first: date) -> str:
    found = reached(law, limit_MPa)
    if found.day is None:
        far = _on(first, law.farthest_day)
        return f"Not before {far}, the last predicted day ({FARTHEST:g} times the observed days)."
    ahead = found.day - law.last
    ends = [_on(first, found.earliest or law.first)]
    ends.append("an open end" if found.latest is None else _on(first, found.latest))
    about = f"In about {ahead:.1f} days" if ahead > 0 else "About now"
    return f"{about}, on {_on(first, found.day)} ({ends[0]} to {ends[1]}, 90 %)."


def _on(first: date, day: float) -> str:
    return f"{first + timedelta(days=round(day)):%Y-%m-%d}"


def _bodies(batches: Sequence[StoredBatch]) -> tuple[ReferenceBodyEntry, ...]:
    """Reference bodies by their ids, each with its points in time."""
    points: dict[str, list[tuple[StoredBatch, StoredFruit]]] = defaultdict(list)
    for batch in batches:
        for one in batch.fruit:
            if one.E_known_MPa is not None:
                points[one.fruit_id].append((batch, one))
    entries = []
    for name, own in sorted(points.items()):
        own.sort(key=lambda pair: (pair[0].measured, pair[0].graded_utc))
        history = tuple(_ratio_point(batch, one) for batch, one in own)
        _, last = own[-1]
        known = last.E_known_MPa or math.nan
        entries.append(
            ReferenceBodyEntry(
                fruit_id=name,
                E_known_MPa=known,
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


def _conversion_entry(one: ScaleConversion, *, used: bool) -> ConversionEntry:
    middle = one.predicted(math.exp(one.mean_ln_E))
    half = middle[1] if middle else math.nan
    line = f"{one.intercept:.4g} {'+' if one.slope >= 0 else '-'} {abs(one.slope):.4g} ln(E / MPa)"
    return ConversionEntry(
        title=f"{one.scale}, {one.group}, version {one.version}",
        words=(
            f"{one.scale} = {line}; 90 % of further fruit lie within ± {half:.2g}. Fitted "
            f"{one.fitted_utc[:10]} to {one.fruit} fruit of {one.E_low_MPa:.3g} to "
            f"{one.E_high_MPa:.3g} MPa."
        ),
        used=used,
    )
