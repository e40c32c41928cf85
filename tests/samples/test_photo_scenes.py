import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.mat import detect_tags
from recon.mesh_file import read_mesh
from recon.photos import read_photo
from samples.fruit import box_mm, skin_mesh
from samples.scenes.coin import DIAMETER_MM, coin_mesh
from samples.scenes.draw import Scene, draw_scene, scene_mapping
from samples.scenes.ground import GROUNDS, ground_texture
from samples.scenes.jpeg import write_jpeg
from samples.scenes.lens import distorted_pixels, distorted_picture, margin_px, pinhole_pixels
from samples.scenes.light import LIGHTS, flash_mesh, photographer_mesh, room_picture
from samples.scenes.phone import Pipeline, Shot, developed, exposed
from samples.scenes.render import RenderOptions, fruit_mask, widened
from samples.scenes.shape import KINDS
from samples.scenes.sheet import STATES, sheet_height_mm, sheet_mat, sheet_mesh, sheet_texture
from samples.scenes.skin import COLOURS, GLOSSES, skin_attributes
from samples.scenes.write import cameras_mapping, complete, metered_gain, write_scene

SKETCH = RenderOptions(frame_samples=1, print_samples=1, crop_samples=1, skin_cells=24)


@pytest.fixture(scope="module")
def scenes() -> tuple[Scene, ...]:
    return tuple(draw_scene(k, photos=6) for k in range(64))


def silhouette(scene: Scene, k: int, *, cells: int = 72) -> np.ndarray:
    """The truth mesh's filled projection, from what cameras_truth.json holds."""
    vertices, triangles = skin_mesh(scene.fruit.skin, cells=cells)
    return filled(vertices, triangles, cameras_mapping(scene), k)


def filled(vertices: np.ndarray, triangles: np.ndarray, cameras: dict, k: int) -> np.ndarray:
    view = cameras["views"][k]
    seen = vertices @ np.array(view["R"]).T + view["t"]
    pixels = view["f"] * seen[:, :2] / seen[:, 2:] + [(cameras["width"] - 1) / 2, (cameras["height"] - 1) / 2]
    mask = np.zeros((cameras["height"], cameras["width"]), np.uint8)
    # a sixteenfold finer picture, for filling covers every pixel that a polygon touches
    fine = np.zeros((cameras["height"] * 4, cameras["width"] * 4), np.uint8)
    corners = np.rint((4 * pixels + 1.5)[triangles] * 256).astype(np.int32)
    for triangle in corners:
        cv2.fillConvexPoly(fine, triangle, 1, shift=8)
    mask = cv2.resize(fine.astype(np.float32), mask.shape[::-1], interpolation=cv2.INTER_AREA)
    return mask > 0.5


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sum(a & b) / np.sum(a | b))


def test_renderer_sees_the_true_fruit_where_the_true_cameras_put_it(scenes: Iterable[Scene]) -> None:
    pytest.importorskip("mitsuba")
    scene = next(s for s in scenes if s.pipeline.kind == "phone" and s.views[0].focal_px != s.camera.focal_px)
    for k in (0, 5):
        mask = fruit_mask(scene, k, options=replace(SKETCH, skin_cells=72))
        assert overlap(mask, silhouette(scene, k)) > 0.995
