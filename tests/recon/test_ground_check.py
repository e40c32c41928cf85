"""Photos tell where the skin is without outlines: a wrong mesh of an egg is as wrong as it is."""

import re
from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from refusals import refused

from recon.cameras.printed_mat import standard_mat
from recon.checks.ground_check import RimEvidence, rim_evidence
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
from recon.surface.ray_mesh import seeing_views
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
