"""Numbers of another category are doubted: Poisson's ratio, and a mesh of another category's size."""

import pytest

from pipeline.batch.settings import Settings
from pipeline.fruit.category_doubts import of_category, of_poisson_ratio, shipped_categories
from recon.pit.priors import load_prior

NECTARINE = load_prior("nectarine")


def poisson_doubts(**settings):
    return [
        doubt.sentence for doubt in of_poisson_ratio(Settings(category="nectarine", **settings), NECTARINE)
    ]


@pytest.mark.parametrize(
    ("nu", "doubted"), [(0.30, True), (0.404, True), (0.406, False), (0.494, False), (0.496, True)]
)
def test_a_ratio_more_than_three_deviations_from_the_categorys_is_doubted(nu, doubted):
    assert bool(poisson_doubts(poisson_ratio=nu)) == doubted


def test_a_stated_error_of_the_ratio_counts():
    assert not poisson_doubts(poisson_ratio=0.40, poisson_ratio_sd=0.02)
    assert poisson_doubts(poisson_ratio=0.30, poisson_ratio_sd=0.02)
    assert not poisson_doubts()


def test_a_doubted_ratio_is_said_and_widens_the_error_bar_by_what_it_does_to_E():
    """E of the sample's N01 is 14 % too large at 0.30."""
    (doubt,) = of_poisson_ratio(Settings(category="nectarine", poisson_ratio=0.30), NECTARINE)
    said = "poisson_ratio: found 0.3 in batch.toml, expected 0.45 ± 0.015 for the category nectarine"
    assert said in doubt.sentence
    assert 0.07 < doubt.relative_sd < 0.3


def better(size_mm, category):
    """The category that is named in place of the batch's; empty: none."""
    doubts = of_category((size_mm,) * 3, load_prior(category), others=shipped_categories())
    return doubts[0].sentence.split("fits a ")[1].split()[0] if doubts else ""


@pytest.mark.parametrize(
    ("size_mm", "category", "named"),
    [
        (59.5, "plum", "nectarine"),
        (59.5, "nectarine", ""),
        (50.0, "plum", ""),
        (50.0, "nectarine", ""),
        (35.0, "plum", ""),
        (60.0, "apricot", "nectarine"),
        (45.0, "apricot", ""),
        (23.0, "plum", ""),  # a cherry's pit is as large
        (23.0, "cherry", ""),
        (34.0, "cherry", ""),
        (70.0, "apricot", "peach"),
        (42.0, "nectarine", "apricot"),
        (62.0, "peach", ""),
    ],
)
def test_a_size_that_fits_another_category_better_is_doubted_and_one_that_fits_both_is_not(
    size_mm, category, named
):
    assert better(size_mm, category) == named


def test_nectarines_and_peaches_have_pits_alike_and_are_never_told_apart():
    assert {better(size, "nectarine") for size in (50.0, 60.0, 80.0)} == {""}
    assert {better(size, "peach") for size in (60.0, 80.0)} == {""}
    assert "nectarine" not in {better(size, "peach") for size in range(40, 105, 5)}


def test_the_error_bar_holds_what_the_other_pit_does_to_E():
    """E of the sample's N01 is 4.2 % too large with a plum's pit."""
    (doubt,) = of_category((59.5,) * 3, load_prior("plum"), others=shipped_categories())
    assert 0.04 < doubt.relative_sd < 0.2
