"""A textured scan as a fruit's skin: surface, colours and frame against bodies with closed forms."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from samples.appearance import linear_rgb
from samples.cubed_sphere import even_sphere
from samples.fruit import box_mm
from samples.scanned_skin import ScannedSkin, read_scan, skin_of_scan
from samples.scenes.draw import draw_scene, scene_mapping

HALF_MM = np.array([30.0, 28.0, 26.0])
SIDE_PX = 256


def written_ellipsoid(folder: Path, *, turn: np.ndarray, closed: bool = True) -> tuple[Path, Path]:
    """An ellipsoid in metres, turned and shifted, as an OBJ file; red is 40 + 150 u, green 40 + 150 v."""
    sphere = even_sphere(24)
    triangles = sphere.triangles() if closed else sphere.triangles()[40:]
    points = (sphere.directions * HALF_MM) @ turn.T + [50.0, -20.0, 7.0]
    normals = (sphere.directions / HALF_MM) @ turn.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = (sphere.directions[:, :2] + 1) / 2
    lines = ["mtllib ../elsewhere.mtl"]
    lines += [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in (points / 1000).tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv.tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals.tolist()]
    lines += ["f " + " ".join(f"{k}/{k}/{k}" for k in corner) for corner in (triangles + 1).tolist()]
    mesh, texture = folder / "scan.obj", folder / "scan.png"
    mesh.write_text("\n".join(lines) + "\n")
    u, v = np.meshgrid((np.arange(SIDE_PX) + 0.5) / SIDE_PX, 1 - (np.arange(SIDE_PX) + 0.5) / SIDE_PX)
    picture = np.stack([np.full_like(u, 90.0), 40 + 150 * v, 40 + 150 * u], axis=2)
    cv2.imwrite(str(texture), np.rint(picture).astype(np.uint8))
    return mesh, texture


def turned() -> np.ndarray:
    return trimesh.transformations.rotation_matrix(1.1, [0.3, -0.8, 0.5])[:3, :3]


def skin(folder: Path, **options: bool) -> ScannedSkin:
    turn = turned()
    scan = read_scan(*written_ellipsoid(folder, turn=turn, **options), mm_per_unit=1000.0)
    middle = np.array([50.0, -20.0, 7.0])
    return skin_of_scan(scan, stem_mm=middle + turn @ [0, 0, 26.0], suture_mm=middle + turn @ [20.0, 0, -8.0])


def test_a_turned_scan_stands_stem_up_suture_to_x_on_the_plane(tmp_path: Path) -> None:
    made = skin(tmp_path)
    low, high = box_mm(made)
    assert (high - low) / 2 == pytest.approx(HALF_MM, rel=2e-3)
    assert low[2] == pytest.approx(0.0, abs=0.02)
    assert (low + high)[:2] == pytest.approx([0.0, 0.0], abs=0.02)
    assert made.centre_mm == pytest.approx([0.0, 0.0, 26.0], abs=0.03)


def test_its_surface_normals_and_colours_are_those_of_the_body(tmp_path: Path) -> None:
    made = skin(tmp_path)
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(40_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = 1 / np.linalg.norm(directions / HALF_MM, axis=1)
    assert np.abs(made.radius_mm(directions) - radius).max() < 0.05  # flat triangles, 1.9 mm wide
    normals = directions / HALF_MM**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.min(np.sum(made.normals(directions) * normals, axis=1)) > np.cos(
        np.radians(1.0)
    )  # those of flat triangles are off by up to 2.6 degrees
    place = radius[:, None] * directions / HALF_MM
    srgb = np.stack(
        [40 + 75 * (place[:, 0] + 1), 40 + 75 * (place[:, 1] + 1), np.full(len(place), 90.0)], axis=1
    )
    assert np.abs(made.colours(directions) - linear_rgb(srgb / 255)).max() < 0.01


@pytest.mark.parametrize("family", ["mat", "phone", "turntable"])
def test_a_scan_in_the_drawn_fruits_place_leaves_the_rest_of_the_scene(family: str, tmp_path: Path) -> None:
    drawn = draw_scene(4, photos=6, family=family)
    scanned = replace(drawn.fruit, skin=skin(tmp_path))
    scene = draw_scene(4, photos=6, family=family, fruit=("peach", scanned))
    before, after = scene_mapping(drawn), scene_mapping(scene)
    for factor in ("skin", "ground", "mat", "light", "turntable", "pipeline"):
        assert before[factor] == after[factor]
    assert after["fruit"]["size_mm"] == pytest.approx(2 * HALF_MM, rel=2e-3)
