"""A reference body: a solid ball, or any solid, of known modulus, graded with the fruit of a batch."""

from dataclasses import replace
from functools import cache

from pipeline.batch.fruits_table import FruitRow
from recon.pit.priors import PitPrior, load_prior

CATEGORY = "phantom"
"""The category whose rules hold for it, whatever fruit the batch is of."""
NAME = "reference body"
"""What sentences call it."""


@cache
def reference_prior(poisson_ratio: float | None = None) -> PitPrior:
    """What is known of a reference body beforehand: a cast body's rules, no pit, and the ratio given."""
    known = load_prior(CATEGORY)
    ratio = known.poisson_ratio if poisson_ratio is None else poisson_ratio
    return replace(known, category=NAME, poisson_ratio=ratio)


def category_of(row: FruitRow, category: PitPrior | None) -> PitPrior | None:
    """What is known of one row's body: the batch's category, or a reference body's."""
    return reference_prior(row.reference_poisson_ratio) if row.reference else category
