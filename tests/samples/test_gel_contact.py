import numpy as np
import pytest

from samples.gel_contact import Gel, at_markers, gel_areas, gel_points, slid_anchors, traction, untouched

GEL = Gel(kn_MPa_per_mm=0.2, kt_MPa_per_mm=0.05, friction=0.5)


def sheet(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat skin of n x n nine-node cells facing the gel, 10 mm wide, unevenly spaced."""
    line = np.linspace(-1, 1, 2 * n + 1)
    line = 5 * np.sign(line) * np.abs(line) ** 1.2
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, -0.4)], axis=1)
    grid = np.arange(x.size).reshape(x.shape).T
    windows = np.lib.stride_tricks.sliding_window_view(grid, (3, 3))[::2, ::2]
    return points, windows.reshape(-1, 3, 3)


def test_gel_areas_add_up_to_the_sheet() -> None:
    points, cells = sheet(4)
    assert gel_areas(points[:, :2], cells).sum() == pytest.approx(100.0)


def test_markers_see_a_quadratic_field_exactly() -> None:
    points, cells = sheet(4)
    line = np.linspace(-4.5, 4.5, 10)
    rest = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    even = np.stack([points[:, 0], points[:, 1], points[:, 0] + 0.3 * points[:, 1]], axis=1)
    seen = at_markers(rest, points[:, :2], even, cells)
    assert seen == pytest.approx(np.c_[rest, rest[:, 0] + 0.3 * rest[:, 1]], abs=1e-6)
    assert np.all(np.isnan(at_markers(np.array([[7.0, 0.0]]), points[:, :2], even, cells)))


def test_shear_sticks_then_slips_on_the_cone() -> None:
    position = np.array([[0.5, 0.0, -1.0], [4.0, 0.0, -1.0], [0.0, 3.0, 0.2]])
    force, _ = traction(GEL, position, np.zeros((3, 2)))
    assert force == pytest.approx(np.array([[-0.025, 0, 0.2], [-0.1, 0, 0.2], [0, 0, 0]]))


def test_traction_slope_matches_differences() -> None:
    rng = np.random.default_rng(1)
    position, anchor = rng.normal(size=(50, 3)), rng.normal(size=(50, 2))
    _, slope = traction(GEL, position, anchor)
    for axis in range(3):
        push = np.zeros(3)
        push[axis] = 1e-6
        difference = (
            traction(GEL, position + push, anchor)[0] - traction(GEL, position - push, anchor)[0]
        ) / 2e-6
        assert slope[:, :, axis] == pytest.approx(difference, abs=1e-6)


def test_a_node_is_anchored_where_it_came_through_the_face() -> None:
    before = untouched(np.array([[0.0, 0.0, 1.0]]))
    assert gel_points(before, np.array([[3.0, 0.0, -0.5]])) == pytest.approx(np.array([[2.0, 0.0]]))


def test_slip_drags_the_anchor_and_leaves_the_shear_on_the_cone() -> None:
    first = slid_anchors(GEL, untouched(np.array([[0.0, 0.0, 0.0]])), np.array([[0.0, 0.0, -1.0]]))
    dragged = slid_anchors(GEL, first, np.array([[4.0, 0.0, -1.0]]))
    assert dragged.gel_point_mm == pytest.approx(np.array([[2.0, 0.0]]))
    lifted = slid_anchors(GEL, dragged, np.array([[4.0, 0.0, 0.5]]))
    assert not lifted.touching[0]
