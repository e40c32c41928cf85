"""A reference body: a solid ball, or any solid, of known modulus, graded with the fruit of a batch."""

from dataclasses import replace
from functools import cache

from pipeline.batch.fruits_table import FruitRow
from recon.pit.priors import PitPrior, load_prior

CATEGORY = "phantom"
"""The category of a reference body, whatever the batch's category is."""
NAME = "reference body"
"""Its name in sentences."""


@cache
def reference_prior(poisson_ratio: float | None = None) -> PitPrior:
    """The prior of a reference body: the category phantom, with the given Poisson's ratio if there is one."""
    known = load_prior(CATEGORY)
    ratio = known.poisson_ratio if poisson_ratio is None else poisson_ratio
    return replace(known, category=NAME, poisson_ratio=ratio)


def category_of(row: FruitRow, category: PitPrior | None) -> PitPrior | None:
    """The category of one row: a reference body's, else the batch's."""
    return reference_prior(row.reference_poisson_ratio) if row.reference else category
