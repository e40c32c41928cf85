"""A marker that slides out of the frame is followed until less than half of it is left."""

import numpy as np
import pytest
from drawn_gel import RADIUS_PX, SHAPE, drawn, grid
from scipy.spatial import cKDTree

from tactile.markers.marker_detection import uncut
from tactile.markers.tracking import reference_of, track


@pytest.mark.parametrize("s", [-0.15, 0.0, 0.3, 0.7, 1.0, 1.4])
def test_the_visible_part_tells_the_whole_discs_centre(s: float) -> None:
    radius = 5.0
    fine = np.linspace(-0.5, 30.5, 3101)
    x, y = np.meshgrid(fine, fine)
    disc = np.hypot(x - (s * radius - 0.5), y - 15.0) < radius
    centroid = np.array([[x[disc].mean(), y[disc].mean()]])
    found = uncut(centroid, (31, 31), radius)
    np.testing.assert_allclose(found, [[s * radius - 0.5, 15.0]], atol=0.02)


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_markers_slide_out_and_stay_themselves_to_a_third_of_a_pixel(side: str) -> None:
    reference = reference_of(drawn(grid(), noise=1.0), source="drawn")
    order = cKDTree(grid()).query(reference.lattice.rest_px)[1]
    way = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}[side]
    steps = [np.multiply(way, 3.0 * k) for k in range(16)]
    position, _ = track(reference, (drawn(grid() + s, noise=1.0, seed=k) for k, s in enumerate(steps)))
    truth = np.stack([grid()[order] + s for s in steps])
    height, width = SHAPE
    x, y = truth[..., 0], truth[..., 1]
    within = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) + 0.5
    assert np.isfinite(position[within > 0.2 * RADIUS_PX]).all()
    assert not np.isfinite(position[within < -0.6 * RADIUS_PX]).any()
    seen = np.isfinite(position[..., 0])
    assert np.abs(position - truth)[seen & (within > 0)].max() < 0.35
