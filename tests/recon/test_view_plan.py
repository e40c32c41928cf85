"""Missing views are named, and the plan says where to stand."""

import pickle

import numpy as np
import pytest

from recon.cameras.view_plan import missing_views
from recon.recon_failure import ReconFailure, ReconProblem

GIVEN = [f"IMG_{i}.jpg" for i in range(1, 8)]


def _ring(azimuth_deg):
    angle = np.radians(azimuth_deg)
    return np.stack([300 * np.cos(angle), 300 * np.sin(angle), np.full(len(angle), 100.0)], axis=1)


def test_a_side_without_photos_and_a_photo_that_joins_none_are_named():
    placed = [GIVEN[i] for i in (0, 1, 2, 3, 4, 6)]
    said = missing_views(
        placed, _ring([10.0, 50, 95, 140, 170, 330]), np.zeros(3), given=GIVEN, unplaced=[GIVEN[5]]
    )
    assert "take photos at 200, 240, 280 degrees" in said
    assert "between 160 and 320 degrees" in said
    assert "IMG_6.jpg overlaps too little" in said
    assert "between IMG_5.jpg and IMG_7.jpg" in said


@pytest.mark.parametrize("count", [6, 7], ids=["one left out for another reason", "all"])
def test_a_full_ring_lacks_nothing(count):
    around = _ring(np.arange(count) * 360 / count)
    assert missing_views(GIVEN[:count], around, np.zeros(3), given=GIVEN) == ""


def test_a_failure_comes_back_from_a_worker():
    back = pickle.loads(pickle.dumps(ReconFailure(ReconProblem.NO_OVERLAP, "x")))
    assert (back.problem, back.detail) == (ReconProblem.NO_OVERLAP, "x")
