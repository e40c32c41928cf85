"""The photo route end to end, its verdict, and fruit laid upside down: pose known, undersides guessed."""

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import manifold3d
import numpy as np
import pytest
from level_camera import camera_at, direction
from mat_scene import Egg, photographed, ring
from refusals import refused
from scipy.spatial.transform import Rotation

from recon import fruit_mesh, underside
from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.photos import Photo
from recon.cameras.printed_mat import standard_mat
from recon.checks.quality import ReconQuality, require_seen, seen_doubts, shape_doubts
from recon.checks.view_check import view_doubts
from recon.fruit_mesh import ReconOptions, Reconstruction, reconstruct
from recon.pit.priors import load_prior
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.hull import ball
from recon.triangle_mesh import neighbour_mean, open_edges, vertex_normals, volume_mm3
from recon.underside import ScannedSide, both_sides, with_underside
from samples.fruit import Skin, fruit_of_seed, on_its_base, scanned_mesh, skin_mesh, triple

# half axes (mm), spreads of the size and of each axis, depths and widths of stem and groove, lopsidedness
PLUM = ((21.5, 20.0, 24.0), 0.06, 0.03, 0.07, 0.22, 0.01, 0.018, 0.12, 0.010)
CHERRY = ((12.7, 11.9, 12.2), 0.03, 0.02, 0.16, 0.40, 0.015, 0.012, 0.16, 0.012)


def skin_of_kind(kind: tuple, *, seed: int) -> Skin:
    """A skin that stands on z = 0, the same for the same seed."""
    axes, size_sd, axis_sd, stem_depth, stem_width, blossom_depth, groove_depth, groove_width, lopsided_sd = (
        kind
    )
    rng = np.random.default_rng([seed, 6])
    half = np.array(axes) * rng.normal(1.0, size_sd) * rng.normal(1.0, axis_sd, 3)
    mean = float(half.mean())
    skin = Skin(
        half_axes_mm=triple(half),
        stem_depth_mm=mean * stem_depth * float(rng.uniform(0.85, 1.15)),
        stem_width=stem_width * float(rng.uniform(0.9, 1.1)),
        blossom_depth_mm=mean * blossom_depth,
        groove_depth_mm=mean * groove_depth * float(rng.uniform(0.7, 1.3)),
        groove_width=groove_width,
        cubic=rng.normal(0.0, lopsided_sd, (3, 3, 3)),
    )
    return on_its_base(skin)


EGG = Egg()
QUICK = ReconOptions(level=5, max_faces=3000)


@cache
def photos(count: int):
    return photographed(ring(count), egg=EGG, mat=standard_mat())


@cache
def on_the_mat():
    return reconstruct(photos(12), mat=standard_mat(), height_mm=None, options=QUICK)


def test_mesh_is_closed_within_a_pixel_of_the_skin_and_its_quality_is_told():
    reconstruction = on_the_mat()
    assert open_edges(reconstruction.faces) == 0
    assert len(reconstruction.faces) <= 3000
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.02
    )
    assert reconstruction.frame == "mat"
    misses = EGG.misses_mm(reconstruction.vertices)
    assert np.sqrt(np.mean(misses[reconstruction.vertices[:, 2] > 6] ** 2)) < 0.3
    assert 0.3 < reconstruction.surface_sd_mm / np.sqrt(np.mean(misses**2)) < 3
    assert reconstruction.vertices[:, 2].min() > -0.5
    assert reconstruction.quality.views_given == 12
    assert reconstruction.quality.views_used >= 10
    assert reconstruction.quality.silhouette_iou > 0.95
    assert reconstruction.scale_sd < 2e-3


@pytest.mark.slow
def test_a_mesh_that_the_photos_contradict_is_made_again_on_the_same_cameras_and_that_is_said(monkeypatch):
    doubted, placed = [], []

    def contradicted_once(offset, error, evidence, vertices, *_):
        doubted.append(vertices)
        if len(doubted) == 1:
            raise ReconFailure(ReconProblem.SURFACE_CONTRADICTED, "The mesh does not fit the photos.")
        return ()

    def counted(*args):
        placed.append(True)
        return cameras_from_mat(*args)

    monkeypatch.setattr(fruit_mesh, "surface_doubts", contradicted_once)
    monkeypatch.setattr(fruit_mesh, "cameras_from_mat", counted)
    again = reconstruct(photos(12), mat=standard_mat(), height_mm=None, options=QUICK)
    assert (len(doubted), len(placed)) == (2, 1)
    assert again.notes == (fruit_mesh.MADE_TWICE,)
    assert on_the_mat().notes == ()
    # the mesh that was contradicted: the same photos give the same
    assert np.array_equal(doubted[0], on_the_mat().vertices)


@pytest.mark.proof
def test_height_alone_gives_scale_without_a_mat():
    height_mm = 2 * EGG.semi_mm[2]
    reconstruction = reconstruct(photos(14), mat=None, height_mm=height_mm, options=QUICK)
    assert reconstruction.frame == "shape"
    assert np.ptp(reconstruction.vertices[:, 2]) == pytest.approx(height_mm, rel=1e-9)
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.04
    )
    assert 0.003 < reconstruction.scale_sd < 0.03


@pytest.mark.parametrize(
    ("pictures", "mat", "problem", "words"),
    [
        (lambda: photos(12)[:2], standard_mat(), ReconProblem.TOO_FEW_VIEWS, "holds 2 photos"),
        (lambda: photos(12), None, ReconProblem.NO_SCALE, "neither a marker mat"),
    ],
)
def test_refusals_say_why(pictures, mat, problem, words):
    with refused(problem, words):
        reconstruct(pictures(), mat=mat, height_mm=None, options=QUICK)


MAT = standard_mat()


def tagged_photos(azimuths_deg, elevations_deg):
    """Photos with nothing but their tags, taken from 300 mm away."""
    blank = np.zeros((960, 1280, 3), np.uint8)
    tags = np.array(list(MAT.corners_mm))
    noise = np.random.default_rng(3)
    made = []
    for k, (azimuth, elevation) in enumerate(np.broadcast(azimuths_deg, elevations_deg)):
        how = {"size_px": (1280, 960), "focal_px": 1400.0, "name": f"{k:03d}.jpg"}
        camera = camera_at(300.0 * direction(azimuth, elevation), np.zeros(3), **how)
        corners = np.stack([camera.project(MAT.corners_mm[tag]) for tag in tags.tolist()])
        made.append(Photo(camera.name, blank, tags=(tags, corners + noise.normal(0, 0.2, corners.shape))))
    return made


def said(made, **options):
    return view_doubts(made, MAT, given=[photo.name for photo in made], height_mm=55.0, **options)


@pytest.mark.parametrize("count", [12, 24])
def test_photos_all_around_at_two_heights_leave_nothing_to_say(count):
    azimuth = np.arange(count) * 360 / count
    assert said(tagged_photos(azimuth, np.where(np.arange(count) % 2, 25.0, 55.0))) == ()


@pytest.mark.parametrize(("start", "end", "stand"), [(0, 90, "45"), (0, 108, "36, 72")])
def test_a_side_without_a_photo_is_named_with_where_to_stand(start, end, stand):
    azimuth = np.linspace(end, 360 + start, 20)
    (sentence,) = said(tagged_photos(azimuth[::-1], np.tile([25.0, 50.0], 10)))
    assert f"There is a gap of {end - start} degrees without photos around the fruit" in sentence
    assert re.search(rf"between 0 and {end} degrees, counted from 000\.jpg", sentence)
    assert f"take photos at {stand} degrees" in sentence


def test_photos_of_one_half_are_refused_as_grading_refuses_them():
    with refused(ReconProblem.TOO_FEW_VIEWS, r"leave a gap of 180 degrees"):
        said(tagged_photos(np.linspace(0, 180, 16), np.tile([25.0, 50.0], 8)))


def test_photos_from_above_alone_leave_the_lower_part_unseen():
    """From the elevation e, at a distance, a ball is seen down to the latitude e - 90 degrees, and all around
    as far as z = -cos(e): at 70 degrees (1 + cos 70) / 2 = 67 % of it.
    """
    (sentence,) = said(tagged_photos(np.arange(16) * 22.5, 70.0))
    assert abs(int(re.search(r"Only (\d+) % of the surface", sentence)[1]) - 67) <= 8
    assert "take photos from more heights" in sentence


SEEN = ReconQuality(views_given=24, views_used=20, widest_gap_deg=30.0)


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        (replace(SEEN, views_used=5), "only 5 of 24 photos are usable"),
        (replace(SEEN, widest_gap_deg=150.0), "a gap of 150 degrees around"),
    ],
)
def test_a_guessed_shape_is_refused(quality, words):
    with refused(ReconProblem.TOO_FEW_VIEWS, f"Too few views: .*{words}"):
        require_seen(quality)


def test_no_sample_fruit_is_doubted():
    for seed in range(6):
        assert (
            shape_doubts(*scanned_mesh(fruit_of_seed("N", seed=seed, E_MPa=0.5), cells=24, error_mm=0.1))
            == ()
        )


@pytest.mark.parametrize("apart_mm", [40.0, 52.0])
def test_two_fruits_that_touch_are_doubted(apart_mm):
    directions, faces = ball(4)
    first, second = (
        manifold3d.Manifold(manifold3d.Mesh64(28 * directions + [x, 0, 28], faces.astype(np.uint64)))
        for x in (0.0, apart_mm)
    )
    both = (first + second).to_mesh64()
    doubts = shape_doubts(np.asarray(both.vert_properties)[:, :3], np.asarray(both.tri_verts, int))
    assert doubts
    assert all("The photos may show two fruits" in d for d in doubts)


def test_a_bar_and_a_cross_are_phantoms_and_no_fruit():
    bar = manifold3d.Manifold.cube([60.0, 15.0, 15.0], True)
    cross = bar + bar.rotate([0.0, 0.0, 90.0])
    for body, words in (
        (bar, "a ratio of 4.00 of length to width, expected at most 1.45"),
        (cross, "convex hull"),
    ):
        mesh = body.to_mesh64()
        surface = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, int)
        assert any(words in outlier_share for outlier_share in shape_doubts(*surface))
        assert shape_doubts(*surface, body=load_prior("phantom").body) == ()


NOISE_MM, GUESS_MM = 0.05, 0.6


def around(height_mm: float) -> np.ndarray:
    """Thirty-six cameras at three heights, 300 mm away."""
    up, turn = (g.ravel() for g in np.meshgrid(np.radians([12.0, 35.0, 58.0]), np.arange(12) * np.pi / 6))
    way = np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)], axis=1)
    return 300.0 * way + [0.0, 0.0, height_mm / 2]


def scanned(vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator) -> ScannedSide:
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
    upright = scanned(true, faces, rng)
    joined = both_sides(upright, scanned(over, faces, rng))
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
    upright = scanned(plum, faces, rng)
    with refused(ReconProblem.NO_OVERLAP, "another fruit"):
        both_sides(upright, scanned(other, faces, rng))
    larger = scanned(1.02 * laid_over(plum, 3.0, 40.0)[0], faces, rng)
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
    upright = scanned(egg, faces, rng)
    joined = both_sides(upright, scanned(laid_over(egg, 0.0, 5.0)[0], faces, rng))
    assert joined.by_convention
    assert abs(Rotation.from_matrix(joined.upright_from_over[:3, :3]).as_matrix()[0, 0] - 1) < 0.05
    across = scanned(laid_over(egg, 0.0, 90.0)[0], faces, rng)
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
    upright = reconstruction(scanned(true, faces, rng), faces, high[0])
    second = reconstruction(scanned(over, faces, rng), faces, high[1], warnings=("one is dark.",))
    merged = with_underside(upright, tuple, lambda photos: second, mat=None)
    for camera, moved in zip(second.cameras, merged.flipped_cameras, strict=True):
        off = np.linalg.norm(moved.project(true) - camera.project(over), axis=1)
        assert off.max() < 0.02 * np.ptp(camera.project(over), axis=0).max()
    before, after = (volume_mm3(x, faces) for x in (upright.vertices, true))
    assert abs(volume_mm3(merged.vertices, merged.faces) - after) < 0.4 * abs(before - after)
    assert merged.quality.flipped_views == 36
    assert 0.0 < merged.quality.flipped_miss_mm < 3 * NOISE_MM
    assert merged.quality.seen_share > 0.95  # each set alone sees no underside
    assert seen_doubts(upright.quality)
    assert merged.warnings == ("In photos-flipped/: one is dark.",)
    assert merged.surface_sd_mm == pytest.approx(max(0.08, merged.quality.flipped_miss_mm / np.sqrt(2)))
