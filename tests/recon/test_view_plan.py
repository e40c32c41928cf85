"""Missing views are named, and the plan says where to stand."""

import pickle

import cv2
import numpy as np
import pytest

from recon.cameras.view_plan import plan_words, view_plan
from recon.recon_failure import ReconFailure, ReconProblem
from reports.view_plan_picture import view_plan_picture

GIVEN = [f"IMG_{i}.jpg" for i in range(1, 8)]


def _ring(azimuth_deg):
    angle = np.radians(azimuth_deg)
    return np.stack([300 * np.cos(angle), 300 * np.sin(angle), np.full(len(angle), 100.0)], axis=1)


def test_a_side_without_photos_and_a_photo_that_joins_none_are_named():
    placed = [GIVEN[i] for i in (0, 1, 2, 3, 4, 6)]
    plan = view_plan(
        placed, _ring([10.0, 50, 95, 140, 170, 330]), np.zeros(3), given=GIVEN, unplaced=[GIVEN[5]]
    )
    assert [tuple(round(x) for x in gap) for gap in plan.gaps_deg] == [(160, 320)]
    assert [round(s) for s in plan.stand_deg] == [200, 240, 280]
    said = plan_words(plan)
    assert "between 160 and 320 degrees" in said
    assert "IMG_6.jpg overlaps too little" in said
    assert "between IMG_5.jpg and IMG_7.jpg" in said


@pytest.mark.parametrize("count", [6, 7], ids=["one left out for another reason", "all"])
def test_a_full_ring_lacks_nothing(count):
    plan = view_plan(GIVEN[:count], _ring(np.arange(count) * 360 / count), np.zeros(3), given=GIVEN)
    assert (plan.gaps_deg, plan.stand_deg, plan.unplaced, plan_words(plan)) == ((), (), (), "")


def test_every_wide_gap_is_filled_to_half_a_quarter():
    plan = view_plan(GIVEN[:2], _ring([0.0, 100]), np.zeros(3), given=GIVEN[:2])
    around = np.sort([*plan.azimuth_deg, *plan.stand_deg])
    assert np.diff([*around, around[0] + 360]).max() <= 45 + 1e-6


def test_a_failure_brings_its_plan_back_from_a_worker():
    plan = view_plan(GIVEN, _ring(np.arange(7) * 20.0), np.zeros(3), given=GIVEN)
    back = pickle.loads(pickle.dumps(ReconFailure(ReconProblem.NO_OVERLAP, "x", plan)))
    assert back.views == plan


def _picture(**changed):
    plan = {
        "names": ("a.jpg", "b.jpg"), "azimuth_deg": (0.0, 180.0), "distance": (300.0, 300.0), "unplaced": (),
        "gaps_deg": (), "stand_deg": (),
    }  # fmt: skip
    coded = view_plan_picture(**{**plan, **changed})
    return cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR).astype(int)


def _side(before, after, box):
    """How many pixels differ between two pictures inside a box (top, bottom, left, right as shares)."""
    rows, columns = before.shape[:2]
    top, bottom, left, right = (
        round(s * n) for s, n in zip(box, (rows, rows, columns, columns), strict=True)
    )
    return int((np.abs(after - before).max(axis=2) > 8)[top:bottom, left:right].sum())


RIGHT, LEFT = (0.1, 0.85, 0.58, 1.0), (0.1, 0.85, 0.0, 0.42)
BELOW, ABOVE = (0.6, 0.89, 0.0, 1.0), (0.1, 0.4, 0.0, 1.0)


@pytest.mark.parametrize(
    ("changed", "drawn", "untouched"),
    [
        # 0 degrees lies below, and degrees run to the right
        ({"gaps_deg": ((45.0, 135.0),)}, RIGHT, LEFT),
        ({"gaps_deg": ((225.0, 315.0),)}, LEFT, RIGHT),
        ({"stand_deg": (90.0,)}, RIGHT, LEFT),
        ({"stand_deg": (270.0,)}, LEFT, RIGHT),
        ({"azimuth_deg": (0.0, 150.0)}, ABOVE, BELOW),
        ({"azimuth_deg": (30.0, 180.0)}, BELOW, ABOVE),
        # a wide gap is shaded over its whole sector
        ({"gaps_deg": ((10.0, 170.0),)}, (0.15, 0.45, 0.58, 0.8), LEFT),
        ({"gaps_deg": ((10.0, 170.0),)}, (0.55, 0.85, 0.58, 0.8), LEFT),
        # photos that could not be placed are listed at the bottom
        ({"unplaced": ("c.jpg",)}, (0.93, 1.0, 0.0, 1.0), (0.0, 0.9, 0.0, 1.0)),
    ],
)
def test_gaps_standing_places_and_photos_are_drawn_on_their_side_and_nowhere_else(changed, drawn, untouched):
    before, after = _picture(), _picture(**changed)
    assert _side(before, after, drawn) > 100
    assert _side(before, after, untouched) == 0
