"""Slip: how far a sliding skin leaves a marker behind; what the friction cone tells without a model."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.mismatch.effects.slip import LEVEL_MM, slip_path
from fem.mismatch.evidence.friction_cone import ShearRatios

SPRING_RATIO = 0.25
DEPTH_MM = 0.1
STEP_MM = 0.02


def dragged(skin_mm: np.ndarray, mu: float) -> tuple[SimpleNamespace, np.ndarray]:
    """One marker pressed in evenly, whose skin is dragged along x; and where Coulomb's law leaves the gel."""
    bound = mu / SPRING_RATIO * DEPTH_MM
    gel, slid = np.zeros(len(skin_mm)), 0.0
    for frame, skin in enumerate(skin_mm):
        gel[frame] = np.clip(skin - slid, -bound, bound)
        slid = skin - gel[frame]
    moved = np.column_stack([gel, np.zeros_like(gel), np.full_like(gel, -DEPTH_MM)])[:, None]
    plain = np.column_stack([skin_mm, np.zeros_like(gel), np.full_like(gel, -DEPTH_MM)])[:, None]
    tracks = SimpleNamespace(
        position_mm=moved,
        place_mm=np.zeros((1, 3)),
        gel_displacement_mm=moved,
        unit_displacement=plain,
        episode=np.zeros((len(gel), 1), dtype=np.int64),
        sd_mm=np.array([0.004]),
    )
    pose = np.tile(np.eye(4), (1, len(gel), 1, 1))
    recording = SimpleNamespace(tracks=tracks, pose=pose, pad_of_marker=np.array([0]))
    return recording, skin_mm - gel


def path_of(recording: SimpleNamespace, mu: float) -> np.ndarray:
    """With equations that leave every field as it is: the skin is where the plain model says."""
    equations = SimpleNamespace(residual=lambda field: field)
    ratio = np.array([SPRING_RATIO])
    return slip_path(recording, equations, compliance=1.0, mu=mu, spring_ratio=ratio)[:, 0, 0]


def test_a_skin_dragged_forth_and_back_slides_as_coulomb_says():
    out = np.arange(0, 0.2, STEP_MM)
    recording, slid = dragged(np.concatenate([out, out[::-1]]), 0.2)
    assert slid.max() > 0.08
    assert path_of(recording, 0.2) == pytest.approx(slid, abs=1e-12)


def test_nothing_slides_where_friction_is_high():
    recording, slid = dragged(np.arange(0, 0.2, STEP_MM), 0.8)
    assert (slid == 0).all()
    assert (path_of(recording, 0.8) == 0).all()


def test_a_shear_at_the_touch_within_its_own_error_is_no_slip():
    bound = 0.05 / SPRING_RATIO * DEPTH_MM
    recording, _ = dragged(np.full(6, bound + 0.9 * LEVEL_MM), 0.05)
    assert (path_of(recording, 0.05) == 0).all()


def markers(rng: np.random.Generator, mu: float, *, count: int = 400, frames: int = 10) -> ShearRatios:
    """Ratios that fall off from zero, cut by the cone; 3 % noise."""
    asked = np.repeat(rng.exponential(0.06, size=count), frames)
    ratio = np.minimum(asked, mu)
    sd = 0.03 * np.maximum(ratio, 0.02)
    return ShearRatios(
        ratio=np.abs(ratio + sd * rng.normal(size=len(ratio))),
        sd=sd,
        marker=np.repeat(np.arange(count), frames),
    )


@pytest.mark.parametrize("mu", [0.08, 0.12])
def test_markers_that_slip_pile_up_on_the_cone(mu):
    ratios = markers(np.random.default_rng(1), mu)
    tried = np.linspace(0.5 * mu, 2 * mu, 61)
    ratio_of_mu = [ratios.log_ratio(x) for x in tried]
    assert max(ratio_of_mu) > 10
    assert tried[int(np.argmax(ratio_of_mu))] == pytest.approx(mu, rel=0.05)


def test_a_smooth_distribution_is_no_cone():
    for seed in range(20):
        ratios = markers(np.random.default_rng(seed), np.inf)
        assert max(ratios.log_ratio(mu) for mu in np.geomspace(0.05, 1.0, 40)) < 1


@pytest.mark.parametrize(
    ("seed", "spread", "sd", "of_each", "widest", "most"),
    [(3, 0.05, 0.03, 10, 0.18, 0.0), (4, 0.06, 0.01, 1, 0.3, 1.0)],
    ids=["ratios known no better than to themselves", "a broad top"],
)
def test_sizes_of_vectors_of_noise_are_no_cone(seed, spread, sd, of_each, widest, most):
    """The size of a vector of noise is hardly ever near nothing."""
    size = np.linalg.norm(np.random.default_rng(seed).normal(0, spread, (4000, 2)), axis=1)
    marker = np.repeat(np.arange(4000 // of_each), of_each)
    ratios = ShearRatios(ratio=size, sd=np.full(4000, sd), marker=marker)
    assert max(ratios.pile_up(mu) for mu in np.geomspace(0.05, widest, 40)) <= most


def test_markers_beyond_a_cone_refute_it():
    ratios = markers(np.random.default_rng(2), 0.2)
    assert ratios.loss(0.1) > 50
    assert ratios.loss(0.2) < 1
