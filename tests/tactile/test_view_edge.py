"""A contact at the edge of the markers is said, one in their midst is not."""

import numpy as np
import pytest

from tactile.view_edge import edge_said

LINE = np.arange(-4.0, 5.0)
REST = np.stack([*(grid.ravel() for grid in np.meshgrid(LINE, LINE)), np.zeros(81)], axis=1)


def pushed(x_mm: float, y_mm: float) -> np.ndarray:
    """Hertz's pressure, 2.5 mm wide, growing over three frames."""
    away = np.hypot(REST[:, 0] - x_mm, REST[:, 1] - y_mm) / 2.5
    push = np.sqrt(np.maximum(1 - away**2, 0.0))
    return np.stack([np.stack([0 * push, 0 * push, k * push], axis=1) for k in (0.0, 0.5, 1.0)])


def test_a_contact_in_the_middle_is_whole():
    assert edge_said(REST, pushed(0.0, 0.5), "left") == []
    assert edge_said(REST, np.zeros((3, 81, 3)), "left") == []


@pytest.mark.parametrize("place", [(3.0, 0.0), (-3.5, 1.0), (0.0, -3.0), (0.5, 3.5)])
def test_a_contact_at_any_edge_is_said(place):
    assert "reaches the edge of the markers" in edge_said(REST, pushed(*place), "left")[0]
