"""What a camera makes of a scene: focal lengths, white balance, lens and the phone's own processing."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scene_projection import projected

from recon.cameras.photos import read_photo
from samples.scenes.draw import Scene, scene_mapping
from samples.scenes.phone import PIPELINES, Pipeline, developed, draw_pipeline, exposed
from samples.scenes.render import widened
from samples.scenes.write import cameras_mapping, write_jpeg
from samples.viewpoints import Viewpoint, distorted_picture, distorted_pixels, margin_px, pinhole_pixels


@pytest.mark.parametrize("kinds", [("none",), ("phone",), PIPELINES])
def test_a_drawn_pipeline_is_one_of_the_kinds_that_are_asked_for(kinds: tuple[str, ...]) -> None:
    drawn = {draw_pipeline(np.random.default_rng(k), photos=1, kinds=kinds)[0].kind for k in range(30)}
    assert drawn == set(kinds)


def test_focal_lengths_breathe_by_at_most_four_in_a_thousand_and_the_files_say_so(
    scenes: tuple[Scene, ...],
) -> None:
    breathing = 0
    for scene in scenes:
        facts, truth = scene_mapping(scene), cameras_mapping(scene)
        for k, (photo, camera, view) in enumerate(
            zip(facts["photos"], truth["views"], scene.views, strict=True)
        ):
            assert camera["f"] == photo["focal_px"] == view.focal_px
            assert camera["f"] == pytest.approx(truth["f"] * photo["focal_scale"])
            assert abs(photo["focal_scale"] - 1) <= 0.004
            points = np.array([[10.0, -5.0, 3.0], [0.0, 20.0, 0.0]])
            assert projected(points, truth, k) == pytest.approx(view.pixels(points), abs=1e-9)
        breathing += len({view.focal_px for view in scene.views}) > 1
        assert scene.pipeline.kind == "phone" or len({view.focal_px for view in scene.views}) == 1
    assert breathing > 10


def test_white_balance_scales_each_channel_by_the_gain_that_scene_json_states(
    scenes: tuple[Scene, ...],
) -> None:
    scene = next(s for s in scenes if s.pipeline.kind == "phone" and s.shots[0].gains != (1, 1, 1))
    stated = scene_mapping(scene)["photos"][0]["gains"]
    assert all(abs(gain - 1) <= 0.06 for gain in stated)
    grey = np.full((64, 64, 3), 0.2, np.float32)
    quiet = Pipeline(kind="none", sensor_noise=0.0)
    counted = exposed(grey, gain=1.5, pipeline=quiet, shot=replace(scene.shots[0], blur_px=0.0))
    assert counted.mean(axis=(0, 1)) == pytest.approx(0.3 * np.array(stated), rel=1e-3)
    blue, green, red = developed(counted, pipeline=quiet, rng=np.random.default_rng(0))[32, 32] / 255.0
    linear = ((np.array([red, green, blue]) + 0.055) / 1.055) ** 2.4
    # 8-bit levels at 0.3 linear: one level is 0.9 % of the light
    assert linear == pytest.approx(0.3 * np.array(stated), rel=0.01)


def edge_picture(pipeline: Pipeline) -> np.ndarray:
    light = np.full((96, 96, 3), 0.1, np.float32)
    light[:, 48:] = 0.4
    return developed(light, pipeline=pipeline, rng=np.random.default_rng(0)).astype(float)


def test_sharpening_leaves_halos_on_both_sides_of_an_edge() -> None:
    plain = edge_picture(Pipeline(kind="phone", sensor_noise=0.0))
    sharp = edge_picture(Pipeline(kind="phone", sensor_noise=0.0, sharpening=1.0))
    assert sharp[48, 48, 1] > plain[48, 90, 1] + 8
    assert sharp[48, 47, 1] < plain[48, 5, 1] - 8
    assert sharp[48, 5] == pytest.approx(plain[48, 5], abs=1)


def test_noise_reduction_smooths_flats_but_keeps_edges_and_leaves_colour_noise() -> None:
    noisy = edge_picture(Pipeline(kind="phone", sensor_noise=4.0))
    smooth = edge_picture(Pipeline(kind="phone", sensor_noise=4.0, noise_reduction=25.0, chroma_noise=0.0))
    assert smooth[:, :40].std() < 0.6 * noisy[:, :40].std()
    assert smooth[:, 56:].mean() - smooth[:, :40].mean() == pytest.approx(
        noisy[:, 56:].mean() - noisy[:, :40].mean(), abs=1.0
    )
    blotched = edge_picture(Pipeline(kind="phone", sensor_noise=0.0, noise_reduction=25.0, chroma_noise=4.0))
    grey, colour = blotched[:, :40].mean(axis=2), np.ptp(blotched[:, :40], axis=2)
    assert grey.std() < 1.0 < colour.mean()


def test_local_tone_mapping_widens_a_weak_contrast() -> None:
    light = np.full((96, 96, 3), 0.20, np.float32)
    light[::4] = 0.22
    flat = developed(light, pipeline=Pipeline(kind="phone", sensor_noise=0.0), rng=np.random.default_rng(0))
    mapped = developed(
        light,
        pipeline=Pipeline(kind="phone", sensor_noise=0.0, tone_clip=3.0, tone_share=0.7),
        rng=np.random.default_rng(0),
    )
    assert mapped.astype(float).std() > 1.5 * flat.astype(float).std()


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_turned_photo_reads_back_upright(orientation: int, tmp_path: Path) -> None:
    image = np.zeros((60, 80, 3), np.uint8)
    image[:30, :40], image[30:, 40:] = (0, 0, 250), (250, 0, 0)
    write_jpeg(tmp_path / "a.jpg", image, quality=95, orientation=orientation)
    data = (tmp_path / "a.jpg").read_bytes()
    assert (b"Exif" in data) == (orientation != 1)
    stored = cv2.imread(str(tmp_path / "a.jpg"), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    assert stored.shape[:2] == ((80, 60) if orientation in (6, 8) else (60, 80))
    back = read_photo(tmp_path / "a.jpg").image
    assert back.shape == image.shape
    assert np.abs(back.astype(int) - image).mean() < 6


@pytest.mark.parametrize("k1", [-0.05, 0.03])
def test_distortion_moves_a_dot_to_where_the_formula_puts_it_and_can_be_undone(k1: float) -> None:
    view = Viewpoint(cam_from_world=np.eye(4), focal_px=400.0, width_px=480, height_px=360)
    points = np.array([[30.0, 40.0], [239.5, 179.5], [400.0, 300.0]])
    moved = distorted_pixels(points, view, k1=k1)
    assert pinhole_pixels(moved, view, k1=k1) == pytest.approx(points, abs=1e-6)
    out = np.linalg.norm(moved[0] - [239.5, 179.5]) - np.linalg.norm(points[0] - [239.5, 179.5])
    assert np.sign(out) == np.sign(k1)
    assert abs(out) > 2
    margin = margin_px([view], k1=k1)
    wide = widened(view, margin)
    y, x = np.mgrid[: wide.height_px, : wide.width_px]
    for start, end in zip(points, moved, strict=True):
        dot = np.exp(-((x - margin - start[0]) ** 2 + (y - margin - start[1]) ** 2) / 8.0)
        seen = distorted_picture(np.repeat(dot[..., None], 3, axis=2), view, k1=k1, margin=margin)[..., 0]
        row, column = np.unravel_index(np.argmax(seen), seen.shape)
        weights = seen / seen.sum()
        centre = (weights.sum(axis=0) @ np.arange(480), weights.sum(axis=1) @ np.arange(360))
        assert centre == pytest.approx(end, abs=0.1), (row, column)
