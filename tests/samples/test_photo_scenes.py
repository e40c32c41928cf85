"""Scenes that photos are drawn of, and what a camera makes of them."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scene_projection import projected

from recon.cameras.photos import read_photo
from recon.cameras.printed_mat import detect_tags, mat_mapping, parse_mat, standard_mat
from recon.surface.mesh_file import read_mesh
from samples.appearance import mat_texture
from samples.cubed_sphere import even_sphere
from samples.fruit import box_mm, fruit_of_seed, skin_mesh
from samples.renderer import mitsuba
from samples.sample_failure import RendererMissing
from samples.scenes.draw import KINDS, Scene, draw_scene, sample_scene, scene_mapping
from samples.scenes.euro_coin import DIAMETER_MM, coin_mesh
from samples.scenes.ground import GROUNDS, ground_texture
from samples.scenes.light import LIGHTS, flash_mesh, photographer_mesh
from samples.scenes.phone import PIPELINES, Pipeline, developed, draw_pipeline, exposed
from samples.scenes.render import RenderOptions, fruit_cover, load_world, pictures, scaled, widened
from samples.scenes.sheet import STATES, sheet_height_mm, sheet_mat, sheet_mesh, sheet_texture
from samples.scenes.skin_optics import COLOURS, GLOSSES
from samples.scenes.write import cameras_mapping, complete, write_jpeg, write_photos, write_scene
from samples.viewpoints import Viewpoint, distorted_picture, distorted_pixels, margin_px, pinhole_pixels

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
    image = np.clip(255 * mat_texture(mat, pixels_per_mm=6.0), 0, 255).astype(np.uint8)
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


SKETCH = RenderOptions(frame_samples=4, print_samples=4, crop_samples=1, skin_cells=24)


@pytest.fixture(scope="module")
def phone_scenes() -> tuple[Scene, ...]:
    return tuple(draw_scene(k, photos=6, family="phone") for k in range(12))


def smaller(scene: Scene, *, photos: int, shrink: int = 2) -> Scene:
    """The same scene in fewer and smaller photos."""
    views = tuple(
        replace(
            v, focal_px=v.focal_px / shrink, width_px=v.width_px // shrink, height_px=v.height_px // shrink
        )
        for v in scene.views[:photos]
    )
    return replace(scene, views=views, shots=scene.shots[:photos])


def silhouette(vertices: np.ndarray, triangles: np.ndarray, cameras: dict, k: int) -> np.ndarray:
    """The filled projection of a mesh: pixels covered by more than half."""
    finer = 8  # filling covers what a polygon touches: too much by half a fine pixel
    corners = (finer * (projected(vertices, cameras, k) + 0.5) - 0.5)[triangles]
    fine = np.zeros((cameras["height"] * finer, cameras["width"] * finer), np.uint8)
    for triangle in np.rint(corners * 256).astype(np.int32):
        cv2.fillConvexPoly(fine, triangle, 1, shift=8)
    size = (cameras["width"], cameras["height"])
    return np.asarray(cv2.resize(fine.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sum(a & b) / np.sum(a | b))


def test_the_same_number_gives_the_same_scene_and_another_number_another() -> None:
    first, again, other = (scene_mapping(draw_scene(k, photos=6)) for k in (5, 5, 7))
    assert first == again
    for factor in ("fruit", "skin", "ground", "mat", "light", "camera", "pipeline"):
        assert first[factor] != other[factor]
    assert json.loads(json.dumps(first)) == json.loads(json.dumps(again))


@pytest.mark.parametrize(
    ("value_of", "values"),
    [
        (lambda s: s.fruit_kind, KINDS),
        (lambda s: s.skin.colour, COLOURS),
        (lambda s: s.skin.gloss, GLOSSES),
        (lambda s: s.ground.kind, GROUNDS),
        (lambda s: s.sheet.state, STATES),
        (lambda s: s.sheet.size, ("big", "small")),
        (lambda s: s.light.kind, LIGHTS),
        (lambda s: s.pipeline.kind, ("none", "phone")),
        (lambda s: len(s.camera.rings), (2, 3)),
        (lambda s: bool(s.camera.odd_photos), (False, True)),
        (lambda s: s.pipeline.k1 != 0, (False, True)),
        (lambda s: any(shot.orientation != 1 for shot in s.shots), (False, True)),
    ],
)
@pytest.mark.parametrize("half", ["work", "scored"])
def test_every_value_of_every_factor_occurs_in_each_half_of_64_scenes(
    scenes: tuple[Scene, ...], value_of: Callable[[Scene], object], values: tuple, half: str
) -> None:
    assert {value_of(s) for s in scenes if s.half == half} == set(values)


def test_fruit_stands_on_the_plane_in_the_blank_centre_with_its_pit_inside(scenes: tuple[Scene, ...]) -> None:
    for scene in scenes[:24]:
        low, high = box_mm(scene.fruit.skin)
        assert low[2] == pytest.approx(0.0, abs=1e-9)
        assert (low + high)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
        assert np.all(high[:2] < 37.0)
        pit = scene.fruit.pit
        inside = np.array(pit.centre_mm), np.array(pit.semi_axes_mm)
        assert np.all(inside[0] - inside[1] > low)
        assert np.all(inside[0] + inside[1] < high)
        assert 0.15 <= scene.fruit.E_MPa <= 1.6


def test_every_photo_holds_the_whole_fruit(
    scenes: tuple[Scene, ...], phone_scenes: tuple[Scene, ...]
) -> None:
    for scene in (*scenes, *phone_scenes):
        skin = skin_mesh(scene.fruit.skin, cells=8)[0]
        for view in scene.views:
            seen = view.pixels(skin)
            assert np.all((seen > 15) & (seen < [view.width_px - 15, view.height_px - 15]))


def test_a_creased_sheet_lifts_off_by_tenths_of_a_millimetre_but_lies_flat_in_the_blank_centre(
    scenes: tuple[Scene, ...],
) -> None:
    sheets = [s.sheet for s in scenes if s.sheet is not None]
    x, y = np.meshgrid(np.linspace(-90, 90, 361), np.linspace(-90, 90, 361))
    for sheet in sheets[:20]:
        height = sheet_height_mm(sheet, sheet_mat(sheet), x, y)
        blank = 37.0 if sheet.size == "big" else 18.4
        assert np.all(height[np.maximum(np.abs(x), np.abs(y)) < blank] == 0)
        assert height.min() == 0
        assert (0.2 < height.max() < 2.0) == (sheet.state == "creased")
        points, triangles, _ = sheet_mesh(sheet, sheet_mat(sheet), cells=20)
        a, b, c = (points[triangles[:, k]] for k in range(3))
        assert np.all(np.cross(b - a, c - a)[:, 2] > 0)


def test_a_dirty_print_differs_from_the_clean_one_and_most_tags_still_read(scenes: tuple[Scene, ...]) -> None:
    sheet = next(s.sheet for s in scenes if s.sheet is not None and s.sheet.state == "dirty")
    mat = sheet_mat(sheet)
    clean = replace(sheet, state="clean", stains=0, crumbs=0)
    dirty_rgb, clean_rgb = sheet_texture(sheet, mat), sheet_texture(clean, mat)
    assert 0.005 < np.mean(np.abs(dirty_rgb - clean_rgb).max(axis=2) > 0.02) < 0.5
    tags, _ = detect_tags(np.clip(255 * dirty_rgb, 0, 255).astype(np.uint8)[::2, ::2].copy(), mat)
    assert len(tags) > 0.6 * len(mat.corners_mm)


@pytest.mark.parametrize("kind", GROUNDS)
def test_grounds_are_colours_and_the_textured_ones_have_fine_detail(
    scenes: tuple[Scene, ...], kind: str
) -> None:
    ground = next(s.ground for s in scenes if s.ground.kind == kind)
    tile = ground_texture(ground, side_px=512)
    assert tile.shape == (512, 512, 3)
    assert 0 < tile.min() < tile.max() <= 1
    fine = tile - cv2.GaussianBlur(tile, (0, 0), 2.0)
    if kind in ("cloth", "wood", "stone"):
        assert fine.std() / tile.mean() > 0.02


def test_flash_shines_where_the_camera_looks_and_the_photographer_stays_out_of_the_picture(
    scenes: tuple[Scene, ...],
) -> None:
    for scene in scenes:
        for view in scene.views:
            ahead = view.cam_from_world[2, :3]
            if scene.light.flash_radii_mm is not None:
                points, triangles = flash_mesh(scene.light, view)
                a, b, c = (points[triangles[:, k]] for k in range(3))
                normal = np.cross(b - a, c - a).sum(axis=0)
                assert normal / np.linalg.norm(normal) == pytest.approx(ahead, abs=1e-6)
                assert np.all(points @ ahead + view.cam_from_world[2, 3] < 0)
            if scene.light.photographer:
                body, _ = photographer_mesh(view)
                seen = body @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
                across = view.focal_px * np.abs(seen[:, :2]) / np.maximum(seen[:, 2:], 1e-9)
                in_picture = np.all(across < [view.width_px / 2 + 40, view.height_px / 2 + 40], axis=1)
                assert not np.any((seen[:, 2] > 0) & in_picture)


def test_phone_family_has_no_mat_and_in_some_scenes_a_coin_of_its_true_size_beside_the_fruit(
    phone_scenes: tuple[Scene, ...],
) -> None:
    assert [s.seed for s in phone_scenes] == list(range(7000, 7012))
    coins = [s for s in phone_scenes if s.coin is not None]
    assert 3 <= len(coins) <= 9
    for scene in phone_scenes:
        facts = scene_mapping(scene)
        low, high = box_mm(scene.fruit.skin)
        assert facts["mat"] is None
        assert facts["height_mm"] == pytest.approx(high[2] - low[2])
        assert scene.ground.kind in ("cloth", "wood")
        assert scene.pipeline.kind == "phone"
    for scene in coins:
        points, triangles, _ = coin_mesh(scene.coin)
        centre = np.array(scene.coin.centre_mm)
        assert 2 * np.linalg.norm(points[:, :2] - centre, axis=1).max() == pytest.approx(DIAMETER_MM)
        assert points[:, 2].min() == 0
        assert 15 <= np.linalg.norm(centre) - box_mm(scene.fruit.skin)[1][:2].max() - DIAMETER_MM / 2 <= 40
        a, b, c = (points[triangles[:, k]] for k in range(3))
        assert np.cross(b - a, c - a)[:, 2].sum() > 0


def turned_about_z(points_mm: np.ndarray, angle_deg: float) -> np.ndarray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.asarray(points_mm @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]))


def test_before_a_turntable_the_camera_stands_still_and_the_fruit_makes_one_turn() -> None:
    room = np.random.default_rng(0).uniform(-200, 200, (20, 3))
    for scene in (draw_scene(k, photos=6, family="turntable") for k in range(6)):
        turns = np.array([view.azimuth_deg for view in scene.views])
        rays = [
            (view.pixels(turned_about_z(room, turn)) - [(view.width_px - 1) / 2, (view.height_px - 1) / 2])
            / view.focal_px
            for view, turn in zip(scene.views, turns, strict=True)
        ]
        assert np.ptp(rays, axis=0).max() < 1e-9
        assert np.diff(np.degrees(np.unwrap(np.radians(turns)))) == pytest.approx(60.0, abs=8.0)
        assert scene.turntable.card_mm > scene.turntable.radius_mm > 150.0


def test_renderer_leaves_the_card_behind_a_turntable_where_it_is_and_turns_the_mat() -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("pyoidn")
    scene = draw_scene(97, photos=6, family="turntable")
    scene = smaller(scene, photos=6, shrink=4)
    still = tuple(replace(v, focal_px=scene.views[0].focal_px) for v in (scene.views[0], scene.views[2]))
    first, other = pictures(replace(scene, views=still, shots=scene.shots[:2]), options=SKETCH)
    card = slice(2, 32)
    change = np.abs(first - other)
    assert np.median(change[card, 40:-40]) < 0.1 * np.median(first[card, 40:-40])
    assert np.mean(change[60:].max(axis=2) > 0.5 * first[60:].max(axis=2)) > 0.1


def test_renderer_sees_the_true_fruit_where_the_true_cameras_put_it(scenes: tuple[Scene, ...]) -> None:
    pytest.importorskip("mitsuba")
    scene = next(s for s in scenes if len({v.focal_px for v in s.views}) > 1)
    scene = smaller(scene, photos=6)
    cameras = cameras_mapping(scene)
    vertices, triangles = skin_mesh(scene.fruit.skin, cells=72)
    mi = mitsuba()
    world = load_world(mi, scene, options=replace(SKETCH, skin_cells=72))
    for k in (0, 5):
        view = scene.views[k]
        window = (0, 0, view.width_px, view.height_px)
        mask = fruit_cover(mi, world, scene, view, window, finer=4) > 0.5
        assert overlap(mask, silhouette(vertices, triangles, cameras, k)) > 0.995
        shifted = {**cameras, "views": [{**v, "f": 1.01 * v["f"]} for v in cameras["views"]]}
        assert overlap(mask, silhouette(vertices, triangles, shifted, k)) < 0.99


def test_a_written_scene_is_complete_repeatable_and_its_tags_lie_where_its_cameras_say(
    scenes: tuple[Scene, ...], tmp_path: Path
) -> None:
    pytest.importorskip("pyoidn")
    pytest.importorskip("mitsuba")
    scene = next(
        s for s in scenes
        if s.pipeline.k1 != 0 and s.light.kind == "photographer-shadow" and s.sheet is not None
        and s.sheet.size == "big"
    )  # fmt: skip
    scene = smaller(scene, photos=2)
    folder = write_scene(tmp_path, scene, options=SKETCH)
    assert complete(folder, photos=2)
    assert not complete(folder, photos=3)
    facts, truth = (json.loads((folder / f"{n}.json").read_text()) for n in ("scene", "cameras_truth"))
    assert facts["half"] == scene.half
    assert all(photo["exposure_gain"] > 0 for photo in facts["photos"])
    mat = parse_mat(json.loads((folder / "mat.json").read_text()), source="mat.json")
    assert mat_mapping(mat) == mat_mapping(sheet_mat(scene.sheet))
    vertices, _ = read_mesh(folder / "fruit_truth.ply")
    assert np.ptp(vertices, axis=0) == pytest.approx(facts["fruit"]["size_mm"], abs=0.1)
    for k, view in enumerate(scene.views):
        image = read_photo(folder / "photos" / f"{k:03d}.jpg").image
        assert image.shape == (view.height_px, view.width_px, 3)
        assert 25 < image.mean() < 230
        tags, corners = detect_tags(image, mat)
        assert len(tags) >= 4
        pinhole = np.concatenate([projected(mat.corners_mm[tag], truth, k) for tag in tags.tolist()])
        off = corners.reshape(-1, 2) - distorted_pixels(pinhole, view, k1=truth["k1"])
        assert np.median(np.linalg.norm(off, axis=1)) < 1.0  # small tags, a blurred phone picture
        assert np.abs(off.mean(axis=0)).max() < 0.25
    before = (folder / "photos" / "000.jpg").read_bytes()
    again = write_scene(tmp_path / "again", scene, options=SKETCH)
    assert (again / "photos" / "000.jpg").read_bytes() == before


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
    assert (b"Exif" in (tmp_path / "a.jpg").read_bytes()) == (orientation != 1)
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
