"""The fruit in three dimensions: what another reader of glTF finds in the file."""

import io
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from browser import chromium
from report_batches import batch_of, graded_fruit

from reports.fruit_scene import PIT_TRIANGLES, SKIN_TRIANGLES, SceneSurface, fruit_scene
from reports.page import report_html
from reports.skin_layer import FLESH, PADS, PIT, SkinLayer


def ball(radius_mm, subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return SceneSurface(np.array(mesh.vertices), np.array(mesh.faces))


def patch(radius_mm):
    """Markers 1 mm apart on the ball's +x side."""
    line = np.arange(-4.0, 5.0)
    y, z = (grid.ravel() for grid in np.meshgrid(line, line))
    return np.column_stack([np.sqrt(radius_mm**2 - y**2 - z**2), y, z])


@pytest.fixture(scope="module")
def opened():
    made = fruit_scene(ball(30.0, 5), ball(12.0, 4), {"left": patch(30.0), "right": np.empty((0, 3))})
    assert len(made) < 60_000
    scene = trimesh.load(io.BytesIO(made), file_type="glb")
    assert isinstance(scene, trimesh.Scene)
    return scene


def test_skin_and_pit_keep_their_shape_and_close(opened):
    for name, radius_mm, most in (("skin", 30.0, SKIN_TRIANGLES), ("pit", 12.0, PIT_TRIANGLES)):
        mesh = opened.geometry[name]
        assert len(mesh.faces) <= 1.02 * most
        mesh.merge_vertices()
        assert mesh.is_watertight
        assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(radius_mm, rel=0.02)
        assert mesh.volume == pytest.approx(4 / 3 * np.pi * radius_mm**3, rel=0.02)


def test_the_skin_is_painted_where_a_pad_touched_and_lets_the_pit_show(opened):
    skin = opened.geometry["skin"]
    colour = skin.visual.vertex_attributes["color"]
    away = np.linalg.norm(skin.vertices - [30.0, 0, 0], axis=1)
    assert (colour[away < 3][:, :3] == np.round(255 * np.array(PADS[0]))).all()
    assert len(np.unique(colour[away > 9], axis=0)) == 1
    assert colour[away > 9][0, 3] < 150 < colour[away < 3][0, 3]
    assert (opened.geometry["pit"].visual.vertex_attributes["color"][:, 3] == 255).all()


def test_a_fruit_without_a_pit_is_its_skin_alone():
    scene = trimesh.load(io.BytesIO(fruit_scene(ball(30.0, 2), None, {})), file_type="glb")
    assert list(scene.geometry) == ["skin"]


def test_a_map_of_the_skin_is_a_second_set_of_colours():
    """As another reader finds it; red is low, blue is high, skin that is not shown is flesh."""
    skin = ball(30.0, 5)
    x, _, z = skin.vertices.T
    layer = SkinLayer(name="m", values=np.sign(z) * 50.0, shown=x > 10.0, limit=50.0, unit="µm")
    made = fruit_scene(skin, ball(12.0, 2), {}, layer)
    content = json.loads(made[20 : 20 + int.from_bytes(made[12:16], "little")])
    pit, outer = content["meshes"]
    assert "extras" not in pit
    assert outer["extras"]["stem_and_suture"] is True
    assert outer["extras"]["map"] == {"name": "m", "low": "-50 µm", "high": "50 µm"}
    assert {"COLOR_0", "COLOR_1"} < set(outer["primitives"][0]["attributes"])
    outer["primitives"][0]["attributes"]["COLOR_0"] = outer["primitives"][0]["attributes"].pop("COLOR_1")
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    rest = made[20 + int.from_bytes(made[12:16], "little") :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    swapped = head + len(text).to_bytes(4, "little") + b"JSON" + text + rest
    mesh = trimesh.load(io.BytesIO(swapped), file_type="glb").geometry["skin"]
    colour = mesh.visual.vertex_attributes["color"].astype(int)
    x, _, z = mesh.vertices.T
    assert (colour[x < 8][:, :3] == np.round(255 * np.array(FLESH))).all()
    low, high = colour[(x > 12) & (z < -3)], colour[(x > 12) & (z > 3)]
    assert (low[:, 0] > low[:, 2] + 60).all()
    assert (high[:, 2] > high[:, 0] + 60).all()


SKIN_BGR, PIT_BGR = (30, 200, 60), tuple(255 * np.array(PIT)[::-1])
FLESH_BGR = (140, 214, 250)
NORMAL_SHARE = np.cos(0.35) * np.cos(0.6)
"""Cosine of the section's normal and the first view: how much narrower the section looks."""


def one_colour(bgr):
    return cv2.imencode(".jpg", np.full((64, 128, 3), bgr, np.uint8))[1].tobytes()


@pytest.fixture(scope="module")
def turned_in_browser(tmp_path_factory):
    """A ball of 60 mm with a pit of 24 mm in the middle, in the report's dialog."""
    fruit = graded_fruit("N0", rank=1, E_MPa=0.4)
    scene = fruit_scene(ball(30.0, 4), ball(12.0, 4), {}, photo=one_colour(SKIN_BGR))
    fruit = replace(fruit, pictures=replace(fruit.pictures, scene=scene))
    path = tmp_path_factory.mktemp("scene") / "report.html"
    path.write_text(report_html(batch_of(fruit)), encoding="utf-8")
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(120_000)
        page.goto(path.as_uri())
        page.locator("button.turn").click()
        page.wait_for_timeout(1000)
        if page.locator("#scene .lacking").is_visible():
            pytest.skip("this Chromium has no WebGL 2")
        yield page


def picture_of(page):
    """The canvas as BGR, and where the page has it."""
    room = page.locator("#scene canvas").bounding_box()
    coded = page.locator("#scene canvas").screenshot()
    return cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR).astype(float), room


def hue(bgr):
    return np.array(bgr, float) / np.linalg.norm(bgr)


def test_the_skin_has_the_photos_colour_and_the_bar_the_scene_s_scale(turned_in_browser):
    page = turned_in_browser
    picture, room = picture_of(page)
    assert page.locator("#scene select").input_value() == "photo"
    assert page.locator("#scene .unseen").is_visible()
    middle = picture[picture.shape[0] // 2, picture.shape[1] // 2]
    assert hue(middle) == pytest.approx(hue(SKIN_BGR), abs=0.05)
    row = picture[picture.shape[0] // 2]
    green = row[:, 1] - row[:, 0] > 60
    bar = page.locator("#scene .scale").bounding_box()
    mm = float(page.locator("#scene .scale").inner_text().removesuffix(" mm"))
    assert green.sum() / bar["width"] * mm == pytest.approx(60.0, rel=0.03)
    stem, suture = (page.locator("#scene .end").nth(k).bounding_box() for k in (0, 1))
    assert stem["y"] < room["y"] + 0.3 * room["height"]
    assert suture["x"] > room["x"] + 0.5 * room["width"]


@pytest.mark.parametrize(("scheme", "low", "high"), [("dark", 0, 60), ("light", 200, 255)])
def test_the_ground_behind_the_fruit_is_that_of_the_page(turned_in_browser, scheme, low, high):
    turned_in_browser.emulate_media(color_scheme=scheme)
    picture, _ = picture_of(turned_in_browser)
    corner = picture[:20, :20]
    assert low <= corner.min() <= corner.max() <= high


def cut_open(page, share):
    page.locator("#scene input").fill(str(share))
    page.wait_for_timeout(300)
    return picture_of(page)[0]


def near(picture, bgr, most):
    return np.abs(picture - bgr).max(axis=2) < most


@pytest.mark.parametrize("share", [25, 60])
def test_the_section_cuts_skin_and_pit_as_a_plane_cuts_balls(turned_in_browser, share):
    """Disks of flat colour, whose radii follow from the plane's distance to the middle."""
    page = turned_in_browser
    whole = cut_open(page, 0)
    cut = cut_open(page, share)
    bar = page.locator("#scene .scale").bounding_box()
    mm_per_px = float(page.locator("#scene .scale").inner_text().removesuffix(" mm")) / bar["width"]
    away_mm = 30.0 * (2 * share / 100 - 1)
    skin_mm2, pit_mm2 = (np.pi * max(r**2 - away_mm**2, 0.0) * NORMAL_SHARE for r in (30.0, 12.0))
    assert near(cut, PIT_BGR, 6).sum() * mm_per_px**2 == pytest.approx(pit_mm2, rel=0.04, abs=0.5)
    assert near(cut, FLESH_BGR, 6).sum() * mm_per_px**2 == pytest.approx(skin_mm2 - pit_mm2, rel=0.03)
    assert np.abs(cut_open(page, 0) - whole).mean() < 0.5
