"""Lots of one cultivar together: how fast they soften, and how they differ on their last days."""

from collections.abc import Iterator, Sequence
from itertools import groupby

from pipeline.history.lot_statistics import lot_differences
from pipeline.history.lots_softening import FEWEST_LOTS, lots_softening
from reports.history_entries import GroupEntry, SeriesEntry

MOST_COMPARED = 20
"""All pairs of so many lots are compared: 190 rows. Of more lots, those measured last are. Set by hand."""

NO_LAW = (
    f"There is no common rate of softening yet. The mixed model needs {FEWEST_LOTS} lots with two days each, "
    "and must converge."
)


def lot_groups(series: Sequence[SeriesEntry]) -> Iterator[GroupEntry]:
    """Every cultivar with at least two lots. `series`: in the order of their cultivars."""
    for (category, cultivar), of_group in groupby(series, key=lambda lot: (lot.category, lot.cultivar)):
        lots = tuple(of_group)
        if len(lots) < 2:
            continue
        words, rates = _law(lots)
        last = sorted(lots, key=lambda lot: lot.days[-1].day)[-MOST_COMPARED:]
        last_E = {_on_last_day(lot): lot.days[-1].single_E_MPa for lot in lots if lot in last}
        yield GroupEntry(
            name=" ".join(filter(None, (category, cultivar))),
            series=lots,
            words=words,
            rates=rates,
            differences=tuple(lot_differences(last_E)),
        )


def _on_last_day(lot: SeriesEntry) -> str:
    return f"{lot.lot or 'without a lot'} ({lot.days[-1].day})"


def _law(lots: Sequence[SeriesEntry]) -> tuple[str, dict[str, float]]:
    """In words, and the rate of each lot."""
    E_MPa = {
        lot.lot: {float((day.day - lot.days[0].day).days): day.single_E_MPa for day in lot.days}
        for lot in lots
    }
    law = lots_softening(E_MPa)
    if law is None:
        return NO_LAW, {}
    return (
        f"ln E of this cultivar falls by {law.rate:.3f} a day ({law.low:.3f} to {law.high:.3f}, 90 %). The "
        f"standard deviation of this rate between lots is {law.lot_sd:.3f}.",
        law.rates,
    )
