"""Stem and suture from the shape: found on fruit turned any way, and not found where there are none."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.silhouettes.hull import ball
from recon.surface.orientation import orientation_of, orientation_warnings, to_fruit_frame
from samples.fruit import fruit_of_seed, scanned_mesh


def scanned(seed, **changes):
    fruit = fruit_of_seed("N", seed=seed, E_MPa=0.5)
    fruit = replace(fruit, skin=replace(fruit.skin, **changes))
    return scanned_mesh(fruit, cells=40, error_mm=0.1)


def lumpy(half_axes, wobble_mm):
    """A smooth body with even lumps, no stem, no suture."""
    rng = np.random.default_rng(3)
    directions, faces = ball(4)
    waves = np.cos(directions @ (5 * rng.normal(size=(24, 3))).T + rng.uniform(0, 6.3, 24)).sum(axis=1)
    radius = 1 / np.linalg.norm(directions / np.array(half_axes), axis=1)
    radius += wobble_mm / np.sqrt(np.mean(waves**2)) * waves
    return radius[:, None] * directions, faces


def off_deg(a, b):
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_stem_and_suture_are_found_within_four_degrees_whichever_way_the_fruit_lies(seed):
    vertices, faces = scanned(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    orientation = orientation_of(vertices @ turn.T + [5.0, -40.0, 3.0], faces)
    assert off_deg(orientation.stem, turn[:, 2]) < 4
    assert off_deg(orientation.suture, turn[:, 0]) < 4
    assert orientation.stem_confidence > 0.6
    assert orientation.suture_confidence > 0.45


@pytest.mark.parametrize("half_axes", [(30, 30, 30), (31, 28, 26)])
@pytest.mark.parametrize("wobble_mm", [0.0, 0.1, 0.2])
def test_without_stem_and_suture_the_confidence_is_low(half_axes, wobble_mm):
    orientation = orientation_of(*lumpy(half_axes, wobble_mm))
    assert orientation.stem_confidence < 0.3
    assert orientation.suture_confidence < 0.1
    assert orientation_warnings(orientation) == ()


def test_a_fruit_as_placed_raises_no_doubt():
    for seed in (1, 2, 3):
        assert orientation_warnings(orientation_of(*scanned(seed))) == ()


@pytest.mark.parametrize(
    ("axis", "degrees", "words"),
    [
        ("y", 25, "stem axis appears tilted by 2[2-8] degrees"),
        ("z", -40, "turned by (3[6-9]|4[0-4]) degrees to the right"),
    ],
)
def test_a_fruit_that_stands_otherwise_is_told_with_angle_and_confidence(axis, degrees, words):
    vertices, faces = scanned(1)
    turned = vertices @ Rotation.from_euler(axis, degrees, degrees=True).as_matrix().T
    (outlier_share,) = orientation_warnings(orientation_of(to_fruit_frame(turned)[0], faces))
    assert re.search(words, outlier_share)
