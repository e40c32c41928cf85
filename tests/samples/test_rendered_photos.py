import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.cameras.printed_mat import detect_tags, standard_mat
from samples.appearance import mat_texture, skin_colours, table_texture
from samples.cubed_sphere import even_sphere
from samples.fruit import fruit_of_seed
from samples.photo_set import PhotoOptions, write_photos
from samples.sample_failure import RendererMissing
from samples.viewpoints import rings


@pytest.mark.parametrize("module", ["mitsuba", "pyoidn"])
def test_a_missing_renderer_is_named_with_the_command_that_installs_it(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    if module == "pyoidn":
        pytest.importorskip("mitsuba")
    fruit = fruit_of_seed("a", seed=1, E_MPa=0.5)
    with pytest.raises(RendererMissing, match=r"pip install '\.\[samples\]'"):
        write_photos(tmp_path / "photos", fruit, standard_mat(), views=1, options=PhotoOptions())
    assert not (tmp_path / "photos").exists()


def test_printed_mat_reads_back_with_every_tag_in_its_place() -> None:
    mat = standard_mat()
    print_px = mat_texture(mat, pixels_per_mm=6.0)
    image = np.clip(255 * print_px, 0, 255).astype(np.uint8)
    tags, corners = detect_tags(image, mat)
    assert len(tags) == len(mat.corners_mm)
    for tag, corner in zip(tags.tolist(), corners, strict=True):
        truth = mat.corners_mm[tag][:, :2]
        expected = np.stack([95 + truth[:, 0], 95 - truth[:, 1]], axis=1) * 6.0 - 0.5
        assert corner == pytest.approx(expected, abs=1.0)


def test_every_view_holds_the_whole_fruit_and_most_of_the_mat() -> None:
    fruit = fruit_of_seed("a", seed=1, E_MPa=0.5)
    skin, mat = fruit.skin.points_mm(even_sphere(16).directions), standard_mat()
    views = rings(24, np.random.default_rng(0), aim_mm=(0.0, 0.0, 24.0), width_px=1280, height_px=960)
    assert len(views) == 24
    assert len({view.focal_px for view in views}) == 1
    tags = np.concatenate(list(mat.corners_mm.values()))
    for view in views:
        seen = view.pixels(skin)
        assert np.all((seen > 30) & (seen < [1250, 930]))
        printed = view.pixels(tags)
        assert np.mean(np.all((printed > 0) & (printed < [1279, 959]), axis=1)) > 0.6
        top, bottom = view.pixels(np.array([[0, 0, 50.0], [0, 0, 0]]))
        assert top[1] < bottom[1]


def test_cameras_are_rigid_and_look_down_on_the_mat() -> None:
    for view in rings(12, np.random.default_rng(1), aim_mm=(0, 0, 20), width_px=640, height_px=480):
        turn = view.cam_from_world[:3, :3]
        assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)
        eye = -turn.T @ view.cam_from_world[:3, 3]
        assert eye[2] > 70


def test_ripe_skin_is_redder_than_unripe_and_both_stand_out_from_paper() -> None:
    directions = even_sphere(24).directions
    unripe, ripe = (
        skin_colours(directions, ripeness=r, rng=np.random.default_rng(0)).mean(axis=0) for r in (0.05, 0.95)
    )
    assert ripe[0] / ripe[1] > 2.0 * unripe[0] / unripe[1]
    for colour in (unripe, ripe):
        assert colour[2] / colour.max() < 0.5


def test_textures_are_colours() -> None:
    wood = table_texture(np.random.default_rng(0), side_px=128)
    assert wood.shape == (128, 128, 3)
    assert 0 < wood.min() < wood.max() <= 1


def test_a_tiny_rendered_photo_shows_the_mat_where_the_camera_says(tmp_path: Path) -> None:
    pytest.importorskip("pyoidn")
    mitsuba = pytest.importorskip("mitsuba")
    if mitsuba.variant() is None:
        mitsuba.set_variant("scalar_rgb")
    fruit, mat = fruit_of_seed("a", seed=1, E_MPa=0.5), standard_mat()
    options = PhotoOptions(width_px=480, height_px=360, samples_per_pixel=2, skin_cells=16)
    views = write_photos(tmp_path, fruit, mat, views=1, options=options)
    image = cv2.imread(str(tmp_path / "000.jpg"))
    assert b"Exif" not in (tmp_path / "000.jpg").read_bytes()
    tags, corners = detect_tags(image, mat)
    assert len(tags) >= 8
    truth = np.stack([views[0].pixels(mat.corners_mm[tag]) for tag in tags.tolist()])
    assert np.sqrt(np.mean((truth - corners) ** 2)) < 0.9
