"""A batch with everything awkward in it: failures, hostile and long names, missing values."""

from dataclasses import replace
from datetime import UTC, date, datetime

import pytest
from report_batches import batch_of, graded_fruit

from reports.entries import BatchEntry, FruitEntry, ShoreCorrelation

HOSTILE = "<script>alert('x')</script>&\"q\" {{ 7*7 }}"


@pytest.fixture
def awkward_batch():
    soft, hostile = (
        graded_fruit("N-04", rank=1, E_MPa=0.21),
        graded_fruit(HOSTILE, rank=4, E_MPa=1.42, maturity="unripe"),
    )
    warned = replace(
        graded_fruit("N-01", rank=2, E_MPa=0.33), warnings=(HOSTILE, "Low light"), mismatch="pit_offset+slip"
    )
    bare = FruitEntry(fruit_id="orchard-7-" * 6, ok=True, outcome="graded", rank=3, E_MPa=0.58)
    lost = FruitEntry(
        fruit_id="N-07", ok=False, outcome="too-few-views", reason="Only 2 photos\nwere given, with, commas."
    )
    formula = FruitEntry(fruit_id="=1+1", ok=False, outcome="never-touches", reason="@SUM(A1)", grasps=1)
    return BatchEntry(
        name=f"Lot {HOSTILE}",
        category="nectarine",
        cultivar="Big Top",
        lot=HOSTILE,
        harvest_date=date(2026, 8, 14),
        pulp_temperature_C=20.0,
        classes=(("ripe", 0.35), ("firm-ripe", 0.7), ("unripe", None)),
        settings=(("poisson_ratio", "0.45"), (HOSTILE, HOSTILE)),
        versions=(("drupe", "0.1.0"),),
        inputs=(("fruits/N-04/photos/1.jpg", "ab" * 32),),
        started_utc=datetime(2026, 8, 15, 9, 1, 2, tzinfo=UTC),
        finished_utc=datetime(2026, 8, 15, 9, 13, 40, tzinfo=UTC),
        exit_status=3,
        shore=ShoreCorrelation(n=3, spearman=1.0, pearson=0.97, p=0.0004),
        fruits=(formula, hostile, bare, lost, soft, warned),
    )


@pytest.fixture
def large_batch(awkward_batch):
    fruits = tuple(graded_fruit(f"N-{k:03d}", rank=k + 1, E_MPa=0.2 + 0.02 * k) for k in range(60))
    return replace(awkward_batch, fruits=fruits, exit_status=0, shore=None)


@pytest.fixture
def graded():
    return graded_fruit


@pytest.fixture
def hostile():
    return HOSTILE


@pytest.fixture
def empty_batch():
    return batch_of()
