"""What the fitted model leaves of a recording, per marker, at the greatest force."""

from unittest.mock import Mock

import numpy as np
import pytest

from fem.estimation.modulus import ModulusEstimate
from fem.grasp_history import GraspHistory, PadHistory
from pipeline.fruit.model_curve import FULL_LOAD, residual_at_full_load

MARKERS = {"left": 4, "right": 3}
FORCE_N = np.array([0.0, 1.0, 5.0, 9.2, 10.0, 9.6, 4.0])
USED = np.array([False, True, True, True, True, True, True])


def pad(name, count):
    frames = len(FORCE_N)
    still = np.zeros((frames, count, 3))
    places = np.arange(3.0 * count).reshape(count, 3)
    return PadHistory(
        name=name, rest_mm=places, surface_mm=places + 50, position_mm=still, gel_displacement_mm=still,
        force_N=still, episode=np.zeros((frames, count), dtype=int), displacement_sd_mm=0.01,
        force_sd_N=0.01, lag1=0.0,
    )  # fmt: skip


def test_the_mean_at_full_load_along_each_pads_way_in_of_the_markers_that_touch():
    history = GraspHistory(
        time_s=np.arange(len(FORCE_N)) / 10.0,
        phase=("load",) * len(FORCE_N),
        pads=tuple(pad(name, count) for name, count in MARKERS.items()),
    )
    axes = np.zeros((2, len(FORCE_N), 3))
    axes[0, :, 0], axes[1, :, 0] = 1.0, -1.0
    full = FORCE_N[USED] >= FULL_LOAD * FORCE_N.max()
    assert full.sum() == 3
    residual = np.full((USED.sum(), 7, 3), 99.0)
    residual[full] = [0.004, 99.0, -99.0]
    residual[np.flatnonzero(full)[0], :, 0] = 0.010
    residual[np.flatnonzero(full)[1], 2] = np.nan
    estimate = Mock(spec=ModulusEstimate, loaded=USED, residual_mm=residual)
    by_pad = residual_at_full_load(estimate, history, axes, np.stack([FORCE_N, FORCE_N]))
    places, values = by_pad["left"]
    np.testing.assert_allclose(places, history.pads[0].surface_mm[[0, 1, 3]])
    assert values == pytest.approx([6.0] * 3)
    places, values = by_pad["right"]
    assert len(places) == 3
    assert values == pytest.approx([-6.0] * 3)
