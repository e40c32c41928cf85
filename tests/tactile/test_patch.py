"""A patch's area and outline are those of the closed form."""

import numpy as np
import pytest

from tactile.contact_course import patch_of

X, Y = np.meshgrid(np.arange(20.0) - 9.5, np.arange(20.0) - 9.5)
REST = np.stack([X.ravel(), Y.ravel(), np.zeros(400)], axis=1)


def disc(radius_mm: float, centre: tuple[float, float] = (0.3, -0.2)) -> np.ndarray:
    return np.asarray(np.hypot(REST[:, 0] - centre[0], REST[:, 1] - centre[1]) < radius_mm)


def test_a_discs_area_is_right_without_a_bias() -> None:
    rng = np.random.default_rng(8)
    radii, centres = rng.uniform(3, 7, 60), rng.uniform(-1, 1, (60, 2))
    areas = [patch_of(REST, disc(r, (x, y))).area_mm2 for r, (x, y) in zip(radii, centres, strict=True)]
    error_mm = np.sqrt(np.array(areas) / np.pi) - radii
    assert np.abs(error_mm).max() < 0.25
    assert abs(error_mm.mean()) < 0.03


def test_the_outline_is_the_disc_to_half_a_spacing() -> None:
    patch = patch_of(REST, disc(6.0))
    away = np.linalg.norm(patch.outline_mm - [0.3, -0.2], axis=2)
    assert np.abs(away - 6.0).max() < 0.71
    length = np.linalg.norm(patch.outline_mm[:, 1] - patch.outline_mm[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * np.pi * 6.0, rel=0.2)


def test_a_straight_border_halfway_between_markers_is_exact() -> None:
    patch = patch_of(REST, REST[:, 0] > 1.0)
    np.testing.assert_allclose(patch.outline_mm[..., 0], 1.0, atol=1e-12)
    assert patch.area_mm2 == pytest.approx(19 * 8.5, rel=1e-12)


def test_two_patches_add_up_and_none_is_none() -> None:
    left, right = disc(3.0, (-5.0, 0.1)), disc(3.0, (5.0, 0.1))
    alone = patch_of(REST, left).area_mm2 + patch_of(REST, right).area_mm2
    assert patch_of(REST, left | right).area_mm2 == pytest.approx(alone, rel=1e-12)
    none = patch_of(REST, np.zeros(400, dtype=bool))
    assert none.area_mm2 == 0.0
    assert none.outline_mm.shape == (0, 2, 2)
