"""A batch with everything awkward in it: failures, hostile and long names, missing values."""

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import cv2
import numpy as np
import pytest

from reports.entries import BatchEntry, FruitEntry, FruitPictures, Picture, ShoreCorrelation
from reports.grasp_record import CurveRecord, GraspRecord, ModelCurveRecord

HOSTILE = "<script>alert('x')</script>&\"q\" {{ 7*7 }}"
TINY_WEBP = cv2.imencode(".webp", np.full((8, 8, 3), 90, np.uint8))[1].tobytes()


def graded_fruit(fruit_id, *, rank, E_MPa, maturity="ripe"):
    travel = np.linspace(0.0, 1.5, 30)
    force = 9.0 * E_MPa * travel**1.5
    return FruitEntry(
        fruit_id=fruit_id,
        ok=True,
        outcome="graded",
        rank=rank,
        E_MPa=E_MPa,
        E_sd_MPa=0.03 * E_MPa,
        maturity=maturity,
        maturity_probability=0.93,
        p_softer_than_next=0.88,
        height_mm=57.1234,
        volume_mm3=104123.5,
        grasps=1,
        shore_oo=30.0 + 20.0 * E_MPa,
        pictures=FruitPictures(
            photo=Picture(content=TINY_WEBP, file="fruits/N 1/photo.jpg"),
            mesh=Picture(content=TINY_WEBP, file="fruits/N 1/mesh.webp"),
            surface_sd=Picture(content=TINY_WEBP, file="fruits/N 1/surface-sd.webp"),
            outlines=Picture(content=b"", file="fruits/N 1/outlines.jpg"),
        ),
        recordings=(
            GraspRecord(
                grasp="grasp-1",
                E_energy_MPa=1.01 * E_MPa,
                E_energy_sd_MPa=0.03 * E_MPa,
                E_least_squares_MPa=0.99 * E_MPa,
                E_least_squares_sd_MPa=0.04 * E_MPa,
                residual_um=9.3,
                peak_force_N=float(force[-1]),
                travel_mm=1.5,
                frames_used=30,
                curves=[
                    CurveRecord(
                        pad=pad,
                        travel_mm=list(travel),
                        force_N=list(force + 0.01),
                        model=ModelCurveRecord(
                            travel_mm=list(travel), force_N=list(force), sd_mm=list(0.02 * travel)
                        ),
                    )
                    for pad in ("left", "right")
                ],
            ),
        ),
        facts=(("Views used", "38 of 40"),),
        seconds={"mesh": 42.0},
        peak_memory_MiB=1432.0,
    )


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


def batch_of(*fruits):
    """A batch of these fruit and of nothing else."""
    start = datetime(2026, 8, 15, 9, 0, 0, tzinfo=UTC)
    return BatchEntry(
        name="nothing", category="plum", fruits=fruits, started_utc=start,
        finished_utc=start + timedelta(seconds=1), exit_status=0,
    )  # fmt: skip


@pytest.fixture
def empty_batch():
    return batch_of()
