"""The mesh of a fruit laid upside down, found on the upright one: pose known, undersides guessed wrongly."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from dull_fruit import CHERRY, PLUM, skin_of_kind
from level_camera import camera_at
from refusals import refused
from scipy.spatial.transform import Rotation

from recon import underside
from recon.checks.quality import ReconQuality, seen_doubts
from recon.fruit_mesh import Reconstruction
from recon.recon_failure import ReconFailure, ReconProblem
from recon.triangle_mesh import neighbour_mean, vertex_normals, volume_mm3
from recon.underside import ScannedSide, both_sides, with_underside
from samples.fruit import skin_mesh

NOISE_MM, GUESS_MM = 0.05, 0.6


def around(height_mm: float) -> np.ndarray:
    """Thirty-six cameras at three heights, 300 mm away."""
    up, turn = (g.ravel() for g in np.meshgrid(np.radians([12.0, 35.0, 58.0]), np.arange(12) * np.pi / 6))
    way = np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)], axis=1)
    return 300.0 * way + [0.0, 0.0, height_mm / 2]


def photographed(vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator) -> ScannedSide:
    """As a reconstruction leaves it: smooth errors of 0.05 mm, 0.6 mm too thick where no camera looked."""
    normals = vertex_normals(vertices, faces)
    mean, error = neighbour_mean(faces, len(vertices)), rng.normal(size=len(vertices))
    for _ in range(8):
        error = (error + mean @ error) / 2
    side = ScannedSide.of(vertices, faces, around(float(np.ptp(vertices[:, 2]))))
    off = NOISE_MM * error / error.std() + GUESS_MM * (1 - side.seen)
    return replace(side, vertices=vertices + off[:, None] * normals)


def laid_over(vertices: np.ndarray, tilt_deg: float, turn_deg: float) -> tuple[np.ndarray, Rotation]:
    turn = Rotation.from_euler("xz", [180.0 + tilt_deg, turn_deg], degrees=True)
    over = turn.apply(vertices)
    return over - [0.0, 0.0, over[:, 2].min()], turn


@pytest.mark.parametrize(("kind", "seed", "tilt", "turn"), [(PLUM, 3, 12.0, 250.0), (CHERRY, 10, -8.0, 95.0)])
def test_the_underside_comes_from_the_fruit_laid_over(
    kind: tuple, seed: int, tilt: float, turn: float
) -> None:
    rng = np.random.default_rng(4)
    true, faces = skin_mesh(skin_of_kind(kind, seed=seed), cells=24)
    over, rotation = laid_over(true, tilt, turn)
    upright = photographed(true, faces, rng)
    joined = both_sides(upright, photographed(over, faces, rng))
    wrong = Rotation.from_matrix(joined.upright_from_over[:3, :3]) * rotation
    hidden = upright.seen < 0.3
    normals = vertex_normals(true, faces)
    off_before, off_after = (
        np.abs(np.einsum("ij,ij->i", v - true, normals))[hidden] for v in (upright.vertices, joined.vertices)
    )
    before, after = (np.sqrt(np.mean(off**2)) for off in (off_before, off_after))
    assert np.degrees(wrong.magnitude()) < 4.0
    assert before > 0.5
    assert after < 0.12
    assert joined.miss_mm < 0.15
    assert upright.seen.min() < 0.2
    assert off_after.max() < 0.5 * GUESS_MM < off_before.min()  # one of the two saw each place


def test_another_fruit_and_another_scale_are_refused() -> None:
    rng = np.random.default_rng(5)
    plum, faces = skin_mesh(skin_of_kind(PLUM, seed=3), cells=20)
    other, _ = laid_over(skin_mesh(skin_of_kind(PLUM, seed=8), cells=20)[0], 3.0, 40.0)
    upright = photographed(plum, faces, rng)
    with refused(ReconProblem.NO_OVERLAP, "another fruit"):
        both_sides(upright, photographed(other, faces, rng))
    larger = photographed(1.02 * laid_over(plum, 3.0, 40.0)[0], faces, rng)
    with pytest.raises(ReconFailure, match=r"\+[12]\.\d % larger"):
        both_sides(upright, larger)
    assert both_sides(upright, larger, on_mat=False).miss_mm < 0.15
    with pytest.raises(ReconFailure, match=r"\+[23]\d\.\d % larger"):
        both_sides(upright, replace(larger, vertices=1.25 * larger.vertices), on_mat=False)


def test_of_two_ways_that_fit_the_one_about_the_mats_arrow_counts() -> None:
    rng = np.random.default_rng(6)
    d, faces = skin_mesh(replace(skin_of_kind(PLUM, seed=3), cubic=np.zeros((3, 3, 3))), cells=20)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    belt = np.exp(-((d[:, 2] + 0.9) ** 2) / 0.02)  # the underside alone tells one half turn from the other
    egg = d * (20.0 + 1.5 * d[:, :1] ** 2 + 2.5 * (belt * d[:, 0])[:, None])
    egg = egg - [0.0, 0.0, egg[:, 2].min()]
    upright = photographed(egg, faces, rng)
    over = photographed(laid_over(egg, 0.0, 5.0)[0], faces, rng)
    joined = both_sides(upright, over)
    assert joined.by_convention
    assert abs(Rotation.from_matrix(joined.upright_from_over[:3, :3]).as_matrix()[0, 0] - 1) < 0.05
    across = photographed(laid_over(egg, 0.0, 90.0)[0], faces, rng)
    with pytest.raises(ReconFailure, match="two ways"):
        both_sides(upright, across)


def reconstruction(side: ScannedSide, faces: np.ndarray, height_mm: float, **said: object) -> Reconstruction:
    """A scanned side as a reconstruction from the cameras around it."""
    cameras = [camera_at(place, [0.0, 0.0, height_mm / 2]) for place in around(height_mm)]
    quality = ReconQuality(views_given=36, views_used=36, widest_gap_deg=30.0, seen_share=0.6, k1=0.0)
    made = Reconstruction(
        vertices=side.vertices, faces=faces, scale_sd=0.001, surface_sd_mm=0.08, quality=quality,
        warnings=seen_doubts(quality), frame="mat", cameras=tuple(cameras),
    )  # fmt: skip
    return replace(made, **said)


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photos pass unlooked at."""
    checked = SimpleNamespace(photos=(), warnings=())
    monkeypatch.setattr(underside, "checked_photos", lambda photos, mat: checked)


def test_with_both_sides_the_mesh_is_nearer_and_says_what_both_sets_of_photos_saw(unchecked: None) -> None:
    rng = np.random.default_rng(4)
    true, faces = skin_mesh(skin_of_kind(PLUM, seed=3), cells=24)
    over, _ = laid_over(true, 12.0, 250.0)
    high = float(np.ptp(true[:, 2])), float(np.ptp(over[:, 2]))
    upright = reconstruction(photographed(true, faces, rng), faces, high[0])
    second = reconstruction(photographed(over, faces, rng), faces, high[1], warnings=("one is dark.",))
    merged = with_underside(upright, tuple, lambda photos: second, mat=None)
    for camera, moved in zip(second.cameras, merged.flipped_cameras, strict=True):
        off = np.linalg.norm(moved.project(true) - camera.project(over), axis=1)
        assert off.max() < 0.02 * np.ptp(camera.project(over), axis=0).max()
    before, after = (volume_mm3(x, faces) for x in (upright.vertices, true))
    gained = volume_mm3(merged.vertices, merged.faces)
    assert abs(gained - after) < 0.4 * abs(before - after)
    assert merged.quality.flipped_views == 36
    assert 0.0 < merged.quality.flipped_miss_mm < 3 * NOISE_MM
    assert merged.quality.seen_share > 0.95  # each set alone sees no underside
    assert seen_doubts(upright.quality)
    assert merged.warnings == ("In photos-flipped/: one is dark.",)
    assert merged.surface_sd_mm == pytest.approx(max(0.08, merged.quality.flipped_miss_mm / np.sqrt(2)))
