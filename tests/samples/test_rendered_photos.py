import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.cameras.printed_mat import detect_tags, standard_mat
from samples.appearance import mat_texture
from samples.cubed_sphere import even_sphere
from samples.fruit import fruit_of_seed
from samples.sample_failure import RendererMissing
from samples.scenes.draw import sample_scene
from samples.scenes.render import RenderOptions, scaled
from samples.scenes.write import write_photos

FRUIT = fruit_of_seed("a", seed=1, E_MPa=0.5)


@pytest.mark.parametrize("module", ["mitsuba", "pyoidn"])
def test_a_missing_renderer_is_named_with_the_command_that_installs_it(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    if module == "pyoidn":
        pytest.importorskip("mitsuba")
    with pytest.raises(RendererMissing, match=r"pip install '\.\[samples\]'"):
        write_photos(tmp_path / "photos", sample_scene(FRUIT, photos=1), options=RenderOptions())
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


def test_every_view_of_a_sample_is_rigid_looks_down_and_holds_the_whole_fruit_and_most_of_the_mat() -> None:
    scene = sample_scene(FRUIT, photos=24)
    skin = FRUIT.skin.points_mm(even_sphere(16).directions)
    tags = np.concatenate(list(standard_mat().corners_mm.values()))
    assert len(scene.views) == 24
    assert len({view.focal_px for view in scene.views}) == 1
    for view in scene.views:
        size = np.array([view.width_px, view.height_px])
        seen, printed = view.pixels(skin), view.pixels(tags)
        assert np.all((seen > 20) & (seen < size - 20))
        assert np.mean(np.all((printed > 0) & (printed < size - 1), axis=1)) > 0.6
        top, bottom = view.pixels(np.array([[0, 0, 50.0], [0, 0, 0]]))
        assert top[1] < bottom[1]
        turn = view.cam_from_world[:3, :3]
        assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)
        assert (-turn.T @ view.cam_from_world[:3, 3])[2] > 70


def test_a_tiny_rendered_photo_shows_the_mat_where_the_camera_says(tmp_path: Path) -> None:
    pytest.importorskip("pyoidn")
    mitsuba = pytest.importorskip("mitsuba")
    if mitsuba.variant() is None:
        mitsuba.set_variant("scalar_rgb")
    scene, mat = sample_scene(FRUIT, photos=1), standard_mat()
    view = scaled(scene.views[0], 0.5)
    options = RenderOptions(frame_samples=2, print_samples=2, crop_samples=1, skin_cells=16)
    write_photos(tmp_path, replace(scene, views=(view,)), options=options)
    assert b"Exif" not in (tmp_path / "000.jpg").read_bytes()
    tags, corners = detect_tags(cv2.imread(str(tmp_path / "000.jpg")), mat)
    assert len(tags) >= 8
    truth = np.stack([view.pixels(mat.corners_mm[tag]) for tag in tags.tolist()])
    assert np.sqrt(np.mean((truth - corners) ** 2)) < 0.9
