"""The fruit in three dimensions: what another reader of glTF finds in the file."""

import io

import numpy as np
import pytest
import trimesh

from reports.fruit_scene import PIT_TRIANGLES, SKIN_TRIANGLES, SceneSurface, fruit_scene
from reports.mesh_picture import PADS


def ball(radius_mm: float, subdivisions: int) -> SceneSurface:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return SceneSurface(np.array(mesh.vertices), np.array(mesh.faces))


def patch(radius_mm: float) -> np.ndarray:
    """Markers 1 mm apart on the ball's +x side."""
    line = np.arange(-4.0, 5.0)
    y, z = (one.ravel() for one in np.meshgrid(line, line))
    return np.column_stack([np.sqrt(radius_mm**2 - y**2 - z**2), y, z])


@pytest.fixture(scope="module")
def opened() -> trimesh.Scene:
    made = fruit_scene(ball(30.0, 5), ball(12.0, 4), {"left": patch(30.0), "right": np.empty((0, 3))})
    assert len(made) < 60_000
    found = trimesh.load(io.BytesIO(made), file_type="glb")
    assert isinstance(found, trimesh.Scene)
    return found


def test_skin_and_pit_keep_their_shape_and_close(opened: trimesh.Scene) -> None:
    for name, radius_mm, most in (("skin", 30.0, SKIN_TRIANGLES), ("pit", 12.0, PIT_TRIANGLES)):
        mesh = opened.geometry[name]
        assert len(mesh.faces) <= 1.02 * most
        mesh.merge_vertices()
        assert mesh.is_watertight
        assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(radius_mm, rel=0.02)
        assert mesh.volume == pytest.approx(4 / 3 * np.pi * radius_mm**3, rel=0.02)


def test_the_skin_is_painted_where_a_pad_touched_and_lets_the_pit_show(opened: trimesh.Scene) -> None:
    skin = opened.geometry["skin"]
    colour = skin.visual.vertex_attributes["color"]
    away = np.linalg.norm(skin.vertices - [30.0, 0, 0], axis=1)
    assert (colour[away < 3][:, :3] == np.round(255 * np.array(PADS[0]))).all()
    assert len(np.unique(colour[away > 9], axis=0)) == 1
    assert colour[away > 9][0, 3] < 150 < colour[away < 3][0, 3]
    assert (opened.geometry["pit"].visual.vertex_attributes["color"][:, 3] == 255).all()


def test_a_fruit_without_a_pit_is_its_skin_alone() -> None:
    found = trimesh.load(io.BytesIO(fruit_scene(ball(30.0, 2), None, {})), file_type="glb")
    assert list(found.geometry) == ["skin"]
