"""What came out is not always to be believed: guessed shapes are refused, odd ones doubted."""

from dataclasses import replace

import manifold3d
import numpy as np
import pytest
from refusals import refused

from recon.checks.quality import NOTHING_KNOWN, require_seen, shape_doubts
from recon.pit.priors import load_prior
from recon.recon_failure import ReconProblem
from recon.silhouettes.hull import ball
from samples.fruit import fruit_of_seed, scanned_mesh

SEEN = replace(NOTHING_KNOWN, views_given=24, views_used=20, widest_gap_deg=30.0)


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        (replace(SEEN, views_used=5), "only 5 of 24 photos are usable"),
        (replace(SEEN, widest_gap_deg=150.0), "a gap of 150 degrees around"),
    ],
)
def test_a_guessed_shape_is_refused(quality, words):
    with refused(ReconProblem.TOO_FEW_VIEWS, f"Too few views: .*{words}"):
        require_seen(quality)


def test_no_sample_fruit_is_doubted():
    for seed in range(6):
        assert (
            shape_doubts(*scanned_mesh(fruit_of_seed("N", seed=seed, E_MPa=0.5), cells=24, error_mm=0.1))
            == ()
        )


@pytest.mark.parametrize("apart_mm", [40.0, 52.0])
def test_two_fruits_that_touch_are_doubted(apart_mm):
    directions, faces = ball(4)
    first, second = (
        manifold3d.Manifold(manifold3d.Mesh64(28 * directions + [x, 0, 28], faces.astype(np.uint64)))
        for x in (0.0, apart_mm)
    )
    both = (first + second).to_mesh64()
    doubts = shape_doubts(np.asarray(both.vert_properties)[:, :3], np.asarray(both.tri_verts, int))
    assert doubts
    assert all("The photos may show two fruits" in d for d in doubts)


def test_a_bar_and_a_cross_are_phantoms_and_no_fruit():
    bar = manifold3d.Manifold.cube([60.0, 15.0, 15.0], True)
    cross = bar + bar.rotate([0.0, 0.0, 90.0])
    for body, words in (
        (bar, "a ratio of 4.00 of length to width, expected at most 1.45"),
        (cross, "convex hull"),
    ):
        mesh = body.to_mesh64()
        surface = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, int)
        assert any(words in outlier_share for outlier_share in shape_doubts(*surface))
        assert shape_doubts(*surface, body=load_prior("phantom").body) == ()
