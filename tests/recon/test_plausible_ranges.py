"""A category's plausible ranges: shipped with each, optional in one's own, read strictly."""

import math

import pytest

from recon.pit.priors import known_categories, load_prior
from recon.recon_failure import ReconFailure

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
