"""The photo route end to end on a ray-cast egg: size, shape, scale by mat and height, refusals."""

from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from refusals import refused

from recon import fruit_mesh
from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.printed_mat import standard_mat
from recon.fruit_mesh import ReconOptions, reconstruct
from recon.recon_failure import ReconFailure, ReconProblem
from recon.triangle_mesh import open_edges, volume_mm3

EGG = Egg()
QUICK = ReconOptions(level=5, max_faces=3000)


@cache
def photos(count: int):
    return photographed(ring(count), egg=EGG, mat=standard_mat())


@cache
def on_the_mat():
    return reconstruct(photos(12), mat=standard_mat(), height_mm=None, options=QUICK)


def test_mesh_is_closed_within_a_pixel_of_the_skin_and_its_quality_is_told():
    reconstruction = on_the_mat()
    assert open_edges(reconstruction.faces) == 0
    assert len(reconstruction.faces) <= 3000
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.02
    )
    assert reconstruction.frame == "mat"
    misses = EGG.misses_mm(reconstruction.vertices)
    skin = misses[reconstruction.vertices[:, 2] > 6]
    assert np.sqrt(np.mean(skin**2)) < 0.3
    assert 0.3 < reconstruction.surface_sd_mm / np.sqrt(np.mean(misses**2)) < 3
    assert reconstruction.vertices[:, 2].min() > -0.5
    assert reconstruction.quality.views_given == 12
    assert reconstruction.quality.views_used >= 10
    assert reconstruction.quality.silhouette_iou > 0.95
    assert reconstruction.scale_sd < 2e-3


@pytest.mark.slow
def test_a_mesh_that_the_photos_contradict_is_made_again_on_the_same_cameras_and_that_is_said(monkeypatch):
    doubted, placed = [], []

    def contradicted_once(offset, error, evidence, vertices, *_):
        doubted.append(vertices)
        if len(doubted) == 1:
            raise ReconFailure(ReconProblem.SURFACE_CONTRADICTED, "The mesh does not fit the photos.")
        return ()

    def counted(*args):
        placed.append(True)
        return cameras_from_mat(*args)

    monkeypatch.setattr(fruit_mesh, "surface_doubts", contradicted_once)
    monkeypatch.setattr(fruit_mesh, "cameras_from_mat", counted)
    again = reconstruct(photos(12), mat=standard_mat(), height_mm=None, options=QUICK)
    assert (len(doubted), len(placed)) == (2, 1)
    assert again.notes == (fruit_mesh.MADE_TWICE,)
    assert on_the_mat().notes == ()
    # the mesh that was contradicted: the same photos give the same
    assert np.array_equal(doubted[0], on_the_mat().vertices)


@pytest.mark.proof
def test_height_alone_gives_scale_without_a_mat():
    height_mm = 2 * EGG.semi_mm[2]
    reconstruction = reconstruct(photos(14), mat=None, height_mm=height_mm, options=QUICK)
    assert reconstruction.frame == "shape"
    assert np.ptp(reconstruction.vertices[:, 2]) == pytest.approx(height_mm, rel=1e-9)
    assert volume_mm3(reconstruction.vertices, reconstruction.faces) == pytest.approx(
        EGG.volume_mm3, rel=0.04
    )
    assert 0.003 < reconstruction.scale_sd < 0.03


@pytest.mark.parametrize(
    ("pictures", "mat", "problem", "words"),
    [
        (lambda: photos(12)[:2], standard_mat(), ReconProblem.TOO_FEW_VIEWS, "holds 2 photos"),
        (lambda: photos(12), None, ReconProblem.NO_SCALE, "neither a marker mat"),
    ],
)
def test_refusals_say_why(pictures, mat, problem, words):
    with refused(problem, words):
        reconstruct(pictures(), mat=mat, height_mm=None, options=QUICK)
