"""The pit: where the prior puts it, how it is cut out, and a fruit's stem and suture from its shape."""

import dataclasses
import math
import re
from dataclasses import replace

import manifold3d
import numpy as np
import pytest
import trimesh
from refusals import refused
from scipy.spatial.transform import Rotation

from recon.pit.placement import embed_pit, load_pit, place_pit
from recon.pit.priors import known_categories, load_prior
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.hull import ball
from recon.surface.orientation import orientation_of, orientation_warnings, to_fruit_frame
from recon.triangle_mesh import open_edges, volume_mm3
from samples.fruit import fruit_of_seed, scanned_mesh

OWN = """
category = "kaki"
given_by_batch = ["pit", "poisson_ratio"]
offset_sd_mm = { value = 0.7, source = "own" }
size_sd = { value = 0.05, source = "own" }
"""


def plausible_of(tmp_path, text):
    path = tmp_path / "kaki.toml"
    path.write_text(OWN + text)
    return load_prior(path).plausible


@pytest.mark.parametrize("category", known_categories())
def test_smallest_and_largest_fruit_weigh_what_their_size_says(category):
    said = load_prior(category).plausible
    for size, mass in zip(said.diameter_mm, said.mass_g, strict=True):
        water_g = math.pi / 6 * size**3 / 1000
        assert 0.1 < mass / water_g < 6, (category, size, mass)
    assert said.density_g_per_cm3[0] < 0.94 < 1.24 < said.density_g_per_cm3[1]


@pytest.mark.parametrize(
    ("category", "height_mm", "diameter_mm", "mass_g"),
    [
        ("nectarine", 57, 61, 112),  # Emadi et al. 2011's peach, its size
        ("nectarine", 35, 62, 85),  # a flat nectarine
        ("peach", 32, 70, 110),  # a flat peach
        ("peach", 110, 118, 816),  # the heaviest on record
        ("apricot", 40, 38, 33),
        ("plum", 20, 19, 4),  # a mirabelle
        ("plum", 80, 84, 323),  # the heaviest on record
        ("cherry", 9, 9, 0.5),  # a wild cherry
        ("cherry", 34, 40, 33),  # the heaviest on record
    ],
)
def test_no_real_fruit_lies_outside(category, height_mm, diameter_mm, mass_g):
    said = load_prior(category).plausible
    density = mass_g * 1000 / (math.pi / 6 * height_mm * diameter_mm**2)
    for value, (low, high) in (
        (height_mm, said.height_mm),
        (diameter_mm, said.diameter_mm),
        (mass_g, said.mass_g),
        (density, said.density_g_per_cm3),
        (0.15, said.E_MPa),
        (3.0, said.E_MPa),
    ):
        assert low < value < high


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[plausible]\nheight = [30, 120]\n", 'unknown key "plausible.height"; did you mean "height_mm"?'),
        ("[plausible]\nheight_mm = [120, 30]\n", "plausible.height_mm is [120, 30]; expected [low, high]"),
        ("[plausible]\nheight_mm = 30\n", "plausible.height_mm is 30; expected [low, high]"),
        ("[plausible]\nmass_g = [nan, 1]\n", "plausible.mass_g is [nan, 1]"),
        ("[plausible]\nmass_g = [1, 1e300]\n", "plausible.mass_g is [1, 1e+300]"),
        ("plausible = 3\n", "plausible is 3; expected a table [plausible]"),
    ],
)
def test_a_fault_in_the_table_is_named(tmp_path, text, named):
    with pytest.raises(ReconFailure) as caught:
        plausible_of(tmp_path, text)
    assert named in caught.value.detail


FRUIT = [category for category in known_categories() if category != "phantom"]


@pytest.fixture
def fruit():
    vertices, faces = ball(4)
    return to_fruit_frame(vertices * [30.0, 28.0, 27.0])[0], faces


def test_the_pit_has_the_priors_axes_and_volume(fruit):
    prior = load_prior("nectarine")
    vertices, faces = place_pit(*fruit, prior)
    a, b, c = np.array(prior.axis_ratios) * np.ptp(fruit[0], axis=0) / 2
    assert volume_mm3(vertices, faces) == pytest.approx(4 / 3 * np.pi * a * b * c, rel=1e-3)
    middle = (fruit[0].max(axis=0) + fruit[0].min(axis=0)) / 2
    assert np.allclose(
        vertices.mean(axis=0), middle + np.array(prior.raised) * np.ptp(fruit[0], axis=0) / 2, atol=0.01
    )


def test_flesh_is_fruit_less_pit(fruit):
    vertices, faces = place_pit(*fruit, load_prior("nectarine"))
    embedded = embed_pit(*fruit, vertices, faces)
    assert open_edges(embedded.faces) == 0
    flesh = volume_mm3(*fruit) - volume_mm3(vertices, faces)
    assert embedded.flesh_volume_mm3 == pytest.approx(flesh, rel=1e-9)
    assert volume_mm3(embedded.vertices, embedded.faces) == pytest.approx(flesh, rel=1e-9)
    assert volume_mm3(embedded.vertices, embedded.faces[embedded.on_pit]) < 0
    assert embedded.on_pit.sum() == len(faces)


def test_thinnest_flesh_is_the_least_gap_of_the_two_solids(fruit):
    """Against the exact distance of the pit from what surrounds the fruit."""
    vertices, faces = ball(3)
    bumpy = fruit[0] * (1 + 0.08 * np.sin(fruit[0] @ [[0.3], [0.2], [0.25]]))
    pit = 9 * vertices * [1.2, 0.8, 1.5] + [4.0, -3.0, 28.0]
    skin, stone = (
        manifold3d.Manifold(manifold3d.Mesh64(v, np.asarray(f, np.uint64)))
        for v, f in ((bumpy, fruit[1]), (pit, faces))
    )
    around = manifold3d.Manifold.cube((300.0, 300.0, 300.0), True) - skin
    exact = around.min_gap(stone, 40.0)
    assert embed_pit(bumpy, fruit[1], pit, faces).thinnest_flesh_mm == pytest.approx(exact, abs=0.05)


@pytest.mark.parametrize(
    ("grow", "shift", "words"),
    [
        (4.0, 0.0, "is larger than the fruit"),
        (1.0, 25.0, "of the pit lies outside the fruit"),
        (1.0, 13.9, "at its thinnest"),
    ],
)
def test_a_pit_that_does_not_fit_is_refused(grow, shift, words):
    vertices, faces = ball(3)
    with refused(ReconProblem.PIT_OUTSIDE_FRUIT, words):
        embed_pit(24 * vertices, faces, 10 * grow * vertices + [shift, 0, 0], faces)


def test_open_and_inside_out_meshes_are_refused(fruit):
    vertices, faces = fruit
    pit = place_pit(vertices, faces, load_prior("plum"))
    with refused(ReconProblem.NOT_WATERTIGHT, "fruit's mesh is not watertight: 3 edges"):
        embed_pit(vertices, faces[:-1], *pit)
    with pytest.raises(ReconFailure, match="inside out"):
        embed_pit(vertices, faces[:, ::-1], *pit)


def test_a_users_own_prior_is_read_and_a_bad_one_names_its_field(tmp_path):
    path = tmp_path / "mine.toml"
    numbers = {
        "axis_ratios": [0.4, 0.3, 0.5], "raised": [0, 0, 0], "exponent": 2, "offset_sd_mm": 0.5,
        "size_sd": 0.05, "poisson_ratio": 0.45, "poisson_ratio_sd": 0.01,
    }  # fmt: skip
    good = "".join(f'{name} = {{ value = {number}, source = "own" }}\n' for name, number in numbers.items())
    path.write_text(good)
    assert load_prior(path).category == "mine"
    path.write_text(good.replace("poisson_ratio_sd", "other"))
    with pytest.raises(ReconFailure, match=r"mine\.toml: poisson_ratio_sd is None; expected"):
        load_prior(path)
    path.write_text(good.replace("0.45", "0.5"))
    with refused(ReconProblem.BAD_PRIOR, r"mine\.toml: poisson_ratio is .* expected"):
        load_prior(path)


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_a_measured_pit_takes_the_superellipsoids_place_in_its_own_size(fruit, tmp_path, suffix):
    directions, faces = ball(3)
    stone = [13.0, 9.0, 16.0] * directions * (1 + 0.05 * directions[:, [0]] ** 3) + [100.0, 5.0, -3.0]
    path = tmp_path / f"mine{suffix}"
    path.write_bytes(trimesh.Trimesh(stone, faces, process=False).export(file_type=suffix[1:]))
    prior = load_pit(path, category="nectarine")
    vertices, triangles = place_pit(*fruit, prior)
    assert np.ptp(vertices, axis=0) == pytest.approx(np.ptp(stone, axis=0), abs=1e-4)
    assert volume_mm3(vertices, triangles) == pytest.approx(volume_mm3(stone, faces), rel=1e-5)
    usual = place_pit(*fruit, load_prior("nectarine"))[0]
    middles = [(v.min(0) + v.max(0)) / 2 for v in (vertices, usual)]
    assert middles[0] == pytest.approx(middles[1], abs=1e-4)
    assert prior.size_sd == load_prior("nectarine").size_sd
    assert "mine" in prior.sources["measured"]
    assert repr(load_pit(path, category="nectarine")) == repr(prior)
    path.write_bytes(trimesh.Trimesh(1.1 * stone, faces, process=False).export(file_type=suffix[1:]))
    assert repr(load_pit(path, category="nectarine")) != repr(prior)


def test_every_number_of_a_shipped_prior_has_its_source():
    for category in FRUIT:
        prior = load_prior(category)
        assert prior.fruit_mm is not None
        unsourced = {"category", "sources", "measured", "body", "plausible"}
        assert {f.name for f in dataclasses.fields(prior)} - unsourced == set(prior.sources)
    phantom = load_prior("phantom")
    assert set(phantom.sources) >= {f.name for f in dataclasses.fields(phantom.body)}


def test_a_phantom_says_nothing_of_pit_and_flesh(fruit):
    phantom = load_prior("phantom")
    assert (phantom.has_pit, phantom.poisson_ratio) == (False, None)
    with refused(ReconProblem.NO_PRIOR, r'"phantom" has no default pit; add pit\.ply'):
        place_pit(*fruit, phantom)


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
