"""Builds fruit and batches for tests of reports."""

from datetime import UTC, datetime, timedelta

import cv2
import numpy as np

from reports.entries import BatchEntry, FruitEntry, FruitPictures, Picture
from reports.grasp_record import CurveRecord, GraspRecord, ModelCurveRecord

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


def batch_of(*fruits):
    """A batch of these fruit and of nothing else."""
    start = datetime(2026, 8, 15, 9, 0, 0, tzinfo=UTC)
    return BatchEntry(
        name="nothing",
        category="plum",
        fruits=fruits,
        started_utc=start,
        finished_utc=start + timedelta(seconds=1),
        exit_status=0,
    )
