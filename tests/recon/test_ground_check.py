"""Photos tell where the skin is without outlines, and show relief that outlines bridge."""

import re
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from refusals import refused

from recon.cameras.camera import Camera
from recon.cameras.printed_mat import standard_mat
from recon.checks.ground_check import RimEvidence, rim_evidence
from recon.checks.quality import depth_doubts
from recon.checks.surface_error import (
    in_camera_shadow,
    left_right_px,
    sd_on_patch_mm,
    shadow_sd_mm,
    surface_error,
)
from recon.checks.surface_verdict import moved_doubts, surface_doubts, surface_offset
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.hull import ball
from recon.surface import relief as module
from recon.surface.photo_consistency import Patches, agreement, best_offsets, grey_views
from recon.surface.ray_mesh import open3d, seeing_views
from recon.surface.relief import Relief, relief
from recon.surface.relief_search import at_edge, mean_curvature, outline_mesh
from recon.triangle_mesh import vertex_normals

VIEWS, SAMPLES, DRAWN_MM = 24, 96, 0.25
VIEW = np.repeat(np.arange(VIEWS), SAMPLES)
TURN = np.tile(np.linspace(-np.pi, np.pi, SAMPLES, endpoint=False), VIEWS)


def evidence(offset_px, known=True):
    noise = np.random.default_rng(1).normal(0, 0.3, len(VIEW))
    nothing = np.zeros(len(VIEW))
    return RimEvidence(
        view=VIEW, a=nothing.astype(int), b=nothing.astype(int), t=nothing,
        offset_mm=(offset_px + noise) * DRAWN_MM, sd_mm=nothing + 0.1, pixel_mm=nothing + DRAWN_MM,
        known=np.full(len(VIEW), known), turn=TURN,
    )  # fmt: skip


LOW_LEFT = (np.cos(TURN) < 0) & (np.sin(TURN) < -0.3)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_shadow_low_on_one_side_of_every_photo_is_measured(sign):
    side = LOW_LEFT if sign > 0 else (np.cos(TURN) > 0) & (np.sin(TURN) < -0.3)
    apart = left_right_px(evidence(np.where(side, 2.0, 0.0)))
    assert apart[:2] == pytest.approx([2.0 * sign, 2.0 * sign], abs=0.15)
    assert apart[2] == pytest.approx(0.0, abs=0.15)


def test_edges_on_the_shadows_side_and_below_tell_nothing_of_the_mesh():
    shaded = in_camera_shadow(evidence(np.where(LOW_LEFT, 2.0, 0.0)))
    low = (np.sin(TURN) < np.sin(np.radians(-20))) & (np.sin(TURN) > np.sin(np.radians(-74)))
    assert shaded[low & (np.cos(TURN) < 0)].all()
    assert not shaded[low & (np.cos(TURN) > 0)].any()
    assert shaded[np.sin(TURN) < np.sin(np.radians(-76))].all()
    assert not shaded[np.sin(TURN) > np.sin(np.radians(-14))].any()
    assert not in_camera_shadow(evidence(np.zeros(len(VIEW)))).any()


def test_only_the_bands_with_the_shadow_become_uncertain_and_what_lies_below_them():
    low = np.sin(TURN) < -0.3
    sd_mm = shadow_sd_mm(evidence(np.where(LOW_LEFT, 1.5, -0.5 * low)))
    assert sd_mm[np.sin(TURN) < np.sin(np.radians(-46))] == pytest.approx(2.0 * DRAWN_MM, rel=0.1)
    assert (sd_mm[np.sin(TURN) > np.sin(np.radians(-14))] == 0).all()
    assert (shadow_sd_mm(evidence(np.zeros(len(VIEW)))) == 0).all()


CAMERAS = ring(16)
PLACES = np.array([c.place for c in CAMERAS])
EGG = Egg()
FACES = ball(4)[1]
PIXEL_MM = 0.4


@cache
def images():
    return [p.image for p in photographed(CAMERAS, egg=EGG, mat=standard_mat())]


def skin(grow=1.0):
    return grow * ball(4)[0] * EGG.semi_mm + EGG.centre


def pushed(towards, depth_mm, width=0.12):
    """The skin with a patch moved out along the normals, and how far each vertex was moved."""
    along = np.array(towards) / np.linalg.norm(towards)
    near = np.exp(-(((1 - ball(4)[0] @ along) / width) ** 2)) * depth_mm
    return skin() + near[:, None] * vertex_normals(skin(), FACES), near


@cache
def checked(kind, *args):
    vertices = skin(*args) if kind == "grown" else pushed(*args)[0]
    evidence = rim_evidence(images(), CAMERAS, vertices, FACES)
    views = seeing_views(vertices, FACES, PLACES)
    return vertices, evidence, surface_error(evidence, vertices, FACES, PLACES, views), views


def test_the_true_skin_is_found_within_half_a_pixel_and_not_doubted():
    vertices, evidence, error, views = checked("grown", 1.0)
    assert evidence.known.mean() > 0.7
    assert abs(np.median(evidence.offset_mm[evidence.known])) < PIXEL_MM / 2
    assert error.rms_mm < PIXEL_MM
    offset = surface_offset(error, vertices, FACES, views)
    assert offset.rms_mm < 0.5 * PIXEL_MM
    assert surface_doubts(offset, error, evidence, vertices, FACES, views) == ()


@pytest.mark.parametrize("grow", [0.96, 1.04])
def test_a_mesh_of_another_size_is_measured_as_far_off_as_it_is(grow):
    vertices, evidence, error, views = checked("grown", grow)
    off_mm = (1 - grow) * float(np.mean(EGG.semi_mm))
    assert np.median(evidence.offset_mm[evidence.known]) == pytest.approx(off_mm, abs=PIXEL_MM / 2)
    assert error.rms_mm == pytest.approx(abs(off_mm), rel=0.3)
    offset = surface_offset(error, vertices, FACES, views)
    assert offset.volume_share == pytest.approx(3 * (1 - grow), rel=0.4)  # no ground behind the lowest
    with refused(ReconProblem.SURFACE_CONTRADICTED, "does not fit the photos"):
        surface_doubts(offset, error, evidence, vertices, FACES, views)


@pytest.mark.parametrize("depth_mm", [-1.2, 1.2])
def test_a_patch_pushed_in_or_out_is_found_where_it_is_and_the_error_bar_covers_it(depth_mm):
    towards = (1.0, 0.1, 0.2)
    vertices, evidence, error, views = checked("pushed", towards, depth_mm)
    true_mm = -pushed(towards, depth_mm)[1]
    seen = views >= 2
    peak = np.abs(np.where(seen, error.offset_mm, 0)).argmax()
    assert abs(true_mm[peak]) > 0.5 * abs(depth_mm)
    assert np.sign(error.offset_mm[peak]) == -np.sign(depth_mm)
    assert np.corrcoef(error.offset_mm[seen], true_mm[seen])[0, 1] > 0.8
    assert (np.abs(true_mm[seen]) < 2 * error.sd_mm[seen]).mean() > 0.9
    offset = surface_offset(error, vertices, FACES, views)
    (outlier_share,) = surface_doubts(offset, error, evidence, vertices, FACES, views)
    assert "towards the suture" in outlier_share
    assert ("outside" if depth_mm < 0 else "inside") + " the mesh" in outlier_share


def test_the_error_on_a_patch_is_the_root_mean_square_over_its_area():
    corners = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    sd_mm = 0.1 * corners[:, 0]
    x, y = np.meshgrid(np.linspace(1.005, 2.995, 200), np.linspace(0.5, 3.5, 7))
    above = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.2)])
    # the integral of (0.1 x)² over x in 1..3, over the length
    assert sd_on_patch_mm(above, corners, faces, sd_mm) == pytest.approx(0.1 * np.sqrt(26 / 6), rel=1e-3)


def test_a_mesh_where_there_is_no_fruit_shows_ground_inside_its_rim_and_is_refused():
    bare = [p.image for p in photographed(CAMERAS, egg=None, mat=standard_mat())]
    evidence = rim_evidence(bare, CAMERAS, skin(), FACES)
    views = seeing_views(skin(), FACES, PLACES)
    error = surface_error(evidence, skin(), FACES, PLACES, views)
    offset = surface_offset(error, skin(), FACES, views)
    assert offset.volume_share < -0.1
    with pytest.raises(ReconFailure, match="inside the mesh"):
        surface_doubts(offset, error, evidence, skin(), FACES, views)


@pytest.mark.parametrize(("moved_mm", "grow"), [(1.5, 1.0), (0.0, 1.06)], ids=["moved", "another fruit"])
def test_the_one_photo_whose_fruit_lies_elsewhere_or_is_larger_is_named(moved_mm, grow):
    """The camera with number 3 sees a shift along x shortened to two thirds."""
    names = [camera.name for camera in CAMERAS]
    assert moved_doubts(checked("grown", 1.0)[1], names, 54.0) == ()
    egg = Egg(semi_mm=tuple(grow * a for a in EGG.semi_mm), x_mm=EGG.x_mm + moved_mm, y_mm=EGG.y_mm)
    mixed = list(images())
    mixed[3] = photographed(CAMERAS[3:4], egg=egg, mat=standard_mat())[0].image
    (sentence,) = moved_doubts(rim_evidence(mixed, CAMERAS, skin(), FACES), names, 54.0)
    assert "In 1 photo the fruit has another position or size" in sentence
    apart_mm = float(re.search(rf"\({CAMERAS[3].name} by (\S+) mm\)", sentence)[1])
    assert apart_mm == pytest.approx(moved_mm * 2 / 3 if moved_mm else 2 * 0.06 * 26.0, rel=0.1)


@pytest.mark.parametrize("radius_mm", [10.0, 30.0])
def test_a_ball_has_its_radius_as_curvature_everywhere(radius_mm):
    directions, faces = ball(4)
    curvature = mean_curvature(radius_mm * directions, directions, faces)
    np.testing.assert_allclose(curvature, -1 / radius_mm, rtol=0.01)


def test_an_ellipsoid_is_rounder_at_its_poles_than_at_its_waist_as_its_curvatures_are():
    """H = (1/r1 + 1/r2) / 2: at the pole of semi-axes (a, a, c) c / a², at the waist (1/a + a/c²) / 2."""
    directions, faces = ball(5)
    a, c = 20.0, 26.0
    points = directions * [a, a, c]
    curvature = mean_curvature(points, vertex_normals(points, faces), faces)
    pole, waist = np.abs(directions[:, 2]) > 0.995, np.abs(directions[:, 2]) < 0.05
    assert curvature[pole].mean() == pytest.approx(-c / a**2, rel=0.04)
    assert curvature[waist].mean() == pytest.approx(-(1 / a + a / c**2) / 2, rel=0.04)


RADIUS_MM = 22.0
RIM_RAD = 0.5
PX_PER_MM = 1.5 * 640 / 280
LEVEL = 5
CENTRE = np.array([0.0, 0.0, RADIUS_MM])


@dataclass(frozen=True)
class Scene:
    """True vertices, those that outlines show, which of them are bridged, how many rims hold them, photos."""

    truth: np.ndarray
    outline: np.ndarray
    bridged: np.ndarray
    support: np.ndarray
    images: tuple[np.ndarray, ...]
    cameras: tuple[Camera, ...]


def radii(directions: np.ndarray, depth_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius of a ball bridged by a plane from rim to rim, how far the skin dips under it, and where."""
    angle = np.arccos(np.clip(directions[:, 2], -1, 1))
    inside = angle < RIM_RAD
    lid = RADIUS_MM * np.cos(RIM_RAD) / np.maximum(np.cos(angle), np.cos(RIM_RAD))
    dip = depth_mm * np.cos(np.pi / 2 * np.minimum(angle / RIM_RAD, 1.0)) ** 2
    return np.where(inside, lid, RADIUS_MM), dip, inside


def shape(level: int, depth_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True surface, the same bridged by a plane from rim to rim, and where it is."""
    directions, _ = ball(level)
    bridge, dip, inside = radii(directions, depth_mm)
    return directions * (bridge - dip)[:, None] + CENTRE, directions * bridge[:, None] + CENTRE, inside


@cache
def scene(depth_mm: float, texture: float, gloss: float) -> Scene:
    truth, outline, inside = shape(LEVEL, depth_mm)
    cameras = tuple(ring(20, width=640, height=480))
    rng = np.random.default_rng(5)
    waves = rng.normal(size=(40, 3)) * 1.6  # wavelengths about 2 to 4 mm
    phases = rng.uniform(0, 2 * np.pi, 40)
    lamps = np.array([[0.3, 0.2, 0.93], [-0.5, 0.3, 0.81], [0.1, -0.6, 0.79]])
    fine, faces = shape(LEVEL + 1, depth_mm)[0], ball(LEVEL + 1)[1]
    tensor = open3d().core.Tensor
    caster = open3d().t.geometry.RaycastingScene(nthreads=1)
    caster.add_triangles(tensor(fine.astype(np.float32)), tensor(faces.astype(np.uint32)))
    images = []
    for camera in cameras:
        v, u = np.mgrid[: camera.height_px, : camera.width_px]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)
        near = np.abs(pixels - camera.project(CENTRE[None])).max(axis=1) < 1.3 * RADIUS_MM * PX_PER_MM
        pixels = pixels[near]
        local = np.column_stack([(pixels - camera.middle_px) / camera.focal_px, np.ones(len(pixels))])
        rays = local @ camera.cam_from_world[:3, :3]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        start = np.broadcast_to(camera.place, rays.shape)
        cast = caster.cast_rays(tensor(np.hstack([start, rays]).astype(np.float32)))
        far, normal = cast["t_hit"].numpy(), cast["primitive_normals"].numpy()
        hit = np.isfinite(far)
        point = start[hit] + far[hit, None] * rays[hit]
        skin = np.cos(point @ waves.T + phases).mean(axis=1) * np.sqrt(2 * 40)
        light = 60 + 25 * np.clip(normal[hit] @ lamps[0], 0, 1) + texture * skin
        mirrored = rays[hit] - 2 * np.sum(rays[hit] * normal[hit], axis=1, keepdims=True) * normal[hit]
        for lamp in lamps:
            light = light + gloss * np.clip(mirrored @ lamp, 0, 1) ** 200
        grey = rng.normal(150.0, 1.0, len(near))
        grey[np.flatnonzero(near)[hit]] = light + rng.normal(0, 1.0, len(light))
        picture = np.clip(grey + 0.5, 0, 255).astype(np.uint8).reshape(camera.height_px, camera.width_px)
        images.append(np.repeat(picture[..., None], 3, axis=2))
    return Scene(truth, outline, inside, np.where(inside, 0.0, 1.0), tuple(images), cameras)


@cache
def searched_relief(depth_mm: float, texture: float, gloss: float) -> Relief:
    s = scene(depth_mm, texture, gloss)
    return relief(s.outline, ball(LEVEL)[1], s.images, s.cameras, support=s.support)


def misses_mm(points: np.ndarray, depth_mm: float) -> np.ndarray:
    """How far points near the bridged part lie outside the true skin, measured from the ball's centre."""
    local = points - CENTRE
    size = np.linalg.norm(local, axis=1)
    bridge_mm, dip_mm, _ = radii(local / size[:, None], depth_mm)
    return size - bridge_mm + dip_mm


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize(("highlights", "most"), [(0.0, 0.2), (90.0, 0.5)])
def test_cavity_that_outlines_bridge_is_found_on_textured_skin_under_highlights_too(highlights, most):
    s, got = scene(3.0, 12.0, highlights), searched_relief(3.0, 12.0, highlights)
    before, after = (rms(misses_mm(x[s.bridged], 3.0)) for x in (s.outline, got.vertices))
    assert before > 1.2
    assert after < most * before


def test_hollow_as_deep_as_the_search_looks_is_reported():
    """Such a hollow (0.27 radii, as a scanned peach has) comes out too shallow."""
    deep_mm = 0.27 * RADIUS_MM
    s, got = scene(deep_mm, 12.0, 0.0), searched_relief(deep_mm, 12.0, 0.0)
    assert misses_mm(got.vertices[s.bridged], deep_mm).max() > 0.05 * RADIUS_MM
    assert got.edge_depth_mm > 0.16 * RADIUS_MM
    assert f"{got.edge_depth_mm:.1f} mm deep" in depth_doubts(got.edge_depth_mm)[0]
    assert searched_relief(3.0, 12.0, 0.0).edge_depth_mm == 0.0


@pytest.mark.parametrize("share", [0.071, 0.02])
@pytest.mark.parametrize("upright", [True, False])
def test_depth_at_the_edge_depends_on_whether_skin_is_a_side(share: float, upright: bool):
    """A groove of 0.071 radii is beyond what is searched on a side, and harmless at the top."""
    directions, faces = ball(4)
    mesh = outline_mesh(RADIUS_MM * directions + CENTRE, faces, 4)
    groove = directions[:, 2 if upright else 0] > 0.97
    moved = mesh.outline.points - share * RADIUS_MM * groove[:, None] * mesh.outline.normals
    expected = groove & (not upright and share == 0.071)
    np.testing.assert_array_equal(at_edge(mesh, moved), expected)


def test_what_was_measured_and_what_may_be_bridged_is_told_by_vertex():
    s, got = scene(3.0, 12.0, 0.0), searched_relief(3.0, 12.0, 0.0)
    directions, _ = ball(LEVEL)
    angle = np.arccos(directions[:, 2])
    assert got.measured[angle < 0.6 * RIM_RAD].mean() > 0.9
    assert not got.measured[angle > 2 * RIM_RAD].any()
    assert got.bridged[angle < 0.5 * RIM_RAD].min() > 0.9
    assert got.bridged[angle > 2 * RIM_RAD].max() < 0.1
    assert s.bridged.mean() < 0.1
    held = angle > 2.2 * RIM_RAD  # rims hold round skin: nothing moves
    assert np.array_equal(got.vertices[held], s.outline[held])


@pytest.mark.parametrize(("depth_mm", "gloss"), [(3.0, 0.0), (0.0, 90.0)], ids=["bare", "highlights"])
def test_skin_without_texture_stays_on_the_outlines_also_where_highlights_move(depth_mm, gloss):
    s, got = scene(depth_mm, 0.0, gloss), searched_relief(depth_mm, 0.0, gloss)
    assert np.array_equal(got.vertices, s.outline)
    assert not got.measured.any()
    assert got.bridged[s.bridged].mean() > 0.5


def test_a_flat_top_that_is_as_its_outlines_show_stays():
    s, got = scene(0.0, 12.0, 0.0), searched_relief(0.0, 12.0, 0.0)
    assert rms(np.linalg.norm(got.vertices - s.outline, axis=1)) < 0.02


def test_depth_that_the_held_out_views_deny_is_taken_back():
    """The views held out are of a fruit without the cavity that the others show."""
    s, other = scene(3.0, 12.0, 0.0), scene(0.0, 12.0, 0.0)
    images = [a if i % 2 == 0 else b for i, (a, b) in enumerate(zip(s.images, other.images, strict=True))]
    got = relief(s.outline, ball(LEVEL)[1], images, s.cameras, support=s.support)
    assert np.array_equal(got.vertices, s.outline)


def test_correlation_is_highest_on_the_true_skin():
    s = scene(3.0, 12.0, 0.0)
    row = np.flatnonzero(ball(LEVEL)[0][:, 2] > np.cos(0.1))
    curved = 2 * 3.0 * (np.pi / 2 / (RIM_RAD * RADIUS_MM)) ** 2 - 1 / RADIUS_MM
    up = np.tile([0.0, 0.0, 1.0], (len(row), 1))
    patches = Patches(s.truth[row], up, np.full(len(row), curved))
    offsets = np.linspace(-1.5, 1.5, 13)
    scores, enough = agreement(patches, grey_views(s.images, s.cameras), offsets)
    offset, weight = best_offsets(scores, offsets)
    assert enough.all()
    assert np.all(weight > 0.3)
    assert np.abs(offset).max() < 0.3


def test_what_is_not_found_with_much_averaging_is_found_with_less(monkeypatch: pytest.MonkeyPatch):
    s = scene(3.0, 12.0, 0.0)
    monkeypatch.setattr(module, "LEAST_MEAN_GAIN", 1.1)
    got = relief(s.outline, ball(LEVEL)[1], s.images, s.cameras, support=s.support)
    before, after = (rms(misses_mm(x[s.bridged], 3.0)) for x in (s.outline, got.vertices))
    assert after < 0.2 * before
