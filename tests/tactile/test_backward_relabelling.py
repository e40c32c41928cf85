"""Names that slipped by one place come right again when what follows tells them."""

import numpy as np
from drawn_gel import PITCH_PX, SHAPE, grid
from jaxtyping import Float

from tactile.markers.marker_lattice import lattice_of
from tactile.markers.matching import relabelled

LATTICE = lattice_of(grid(), PITCH_PX, shape=SHAPE, margin_px=0.0)
JUMPS_AT, HEALS_AT, FRAMES = 4, 8, 14
FADE = np.exp(-((grid() - [215.0, 120.0]) ** 2).sum(axis=1) / 2 / 70.0**2)
PATCH = np.flatnonzero(FADE > 0.6)


def truth() -> Float[np.ndarray, "t n 2"]:
    """A patch jumps right by most of a pitch and slowly comes back; the gel around it follows smoothly."""
    where = np.broadcast_to(grid(), (FRAMES, 63, 2)).copy()
    rng = np.random.default_rng(4)
    for t in range(JUMPS_AT, FRAMES):
        where[t, :, 0] += (0.8 - 0.02 * (t - JUMPS_AT)) * PITCH_PX * FADE
    where += rng.normal(scale=0.05, size=where.shape)
    where[where[..., 0] > SHAPE[1] - 1] = np.nan
    return where


def blobs(where: Float[np.ndarray, "t n 2"]) -> list[Float[np.ndarray, "m 2"]]:
    return [frame[np.isfinite(frame[:, 0])] for frame in where]


def slipped(where: Float[np.ndarray, "t n 2"], first: int, end: int) -> Float[np.ndarray, "t n 2"]:
    """In frames `first` to `end` each marker of the patch has the blob of its left neighbour."""
    wrong = where.copy()
    for n in PATCH:
        left = np.flatnonzero(np.linalg.norm(grid() - grid()[n] + [PITCH_PX, 0], axis=1) < 1)
        inside = len(left) > 0 and left[0] in PATCH
        wrong[first:end, n] = where[first:end, left[0]] if inside else np.nan
    return wrong


def test_names_wrong_between_two_jumps_are_set_right() -> None:
    right = truth()
    wrong = slipped(right, JUMPS_AT, HEALS_AT)
    found = relabelled(LATTICE, wrong, blobs(right))
    both = np.isfinite(found) & np.isfinite(right)
    assert np.abs(wrong - right)[np.isfinite(wrong) & np.isfinite(right)].max() > 0.9 * PITCH_PX
    assert np.abs(found - right)[both].max() == 0.0
    assert both.mean() > 0.97 * np.isfinite(right).mean()


def test_a_true_jump_is_left_alone() -> None:
    right = truth()
    np.testing.assert_array_equal(relabelled(LATTICE, right, blobs(right)), right)


def test_a_patch_that_jumps_and_jumps_back_is_left_alone() -> None:
    right = truth()
    right[HEALS_AT:] = right[:1]
    np.testing.assert_array_equal(relabelled(LATTICE, right, blobs(right)), right)
