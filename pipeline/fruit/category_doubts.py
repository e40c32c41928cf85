"""Numbers that belong to another category than the batch's: Poisson's ratio, and the size of the mesh."""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.batch.settings import Settings
from pipeline.fruit.input_doubts import E_PER_SIZE, CategoryKind, Doubt
from recon.pit.priors import PitPrior, known_categories, load_prior

FAR_SD = 3.0
"""Standard deviations of Poisson's ratio from the category's beyond which one of the two is wrong."""
E_PER_NU = 1.0
"""Error of ln E per unit of Poisson's ratio: 0.14 at 0.30 for 0.45 (benchmarks/field_mistakes.py --grade)."""
RANGE_SD = 3.0
"""A category's range of sizes has so many standard deviations of ln size on either side of its middle: both
ends are wider than fruit on sale."""
UNUSUAL_SD = 1.645
"""Sizes further from a category's middle are one in ten of its fruit."""
BETTER = 6.0
"""Likelihood of a size in another category over that in its own from which the other is named (set by hand: a
plum of 57 mm has 6 as a nectarine, and up to 56 mm is no doubt)."""


def of_poisson_ratio(settings: Settings, prior: PitPrior | None) -> list[Doubt]:
    """A ratio in batch.toml that is more than FAR_SD from the category's, errors of both counted."""
    stated = settings.poisson_ratio
    if stated is None or prior is None or prior.poisson_ratio is None:
        return []
    off = stated - prior.poisson_ratio
    sd = math.hypot(prior.poisson_ratio_sd, settings.poisson_ratio_sd or 0.0)
    if abs(off) <= FAR_SD * sd:
        return []
    return [
        Doubt(
            kind=CategoryKind.POISSON_RATIO,
            sentence=(
                f"poisson_ratio: found {stated:g} in batch.toml, expected {prior.poisson_ratio:g} ± "
                f"{prior.poisson_ratio_sd:g} for the category {prior.category}; remove it, or add "
                "poisson_ratio_sd with the error of your own measurement."
            ),
            relative_sd=E_PER_NU * abs(off),
        )
    ]


def of_category(
    box_mm: Sequence[float], prior: PitPrior | None, *, others: Sequence[PitPrior]
) -> list[Doubt]:
    """A size that is unusual in the fruit's category and fits one of the `others` better, whose pit differs.

    The size is the cube root of the volume of the mesh's box. Its logarithm is taken as normal within each
    category.
    """
    if prior is None or prior.axis_ratios is None or prior.fruit_mm is None or prior.measured is not None:
        return []
    size_mm = float(np.cbrt(np.prod(box_mm)))
    log_likelihood = _log_likelihood(size_mm, prior.fruit_mm)
    mean, sd = _ln_size(prior.fruit_mm)
    if abs(math.log(size_mm) - mean) <= UNUSUAL_SD * sd:
        return []
    fits = [
        (_log_likelihood(size_mm, other.fruit_mm), other)
        for other in others
        if other.fruit_mm is not None and other.category != prior.category and _pit_ratio(prior, other)
    ]
    better, other = max(fits, key=lambda fit: fit[0], default=(log_likelihood, prior))
    if better - log_likelihood <= math.log(BETTER):
        return []
    low, high = prior.fruit_mm
    usual, widest = other.fruit_mm or prior.fruit_mm
    return [
        Doubt(
            kind=CategoryKind.SIZE,
            sentence=(
                f"category: the mesh has a mean size of {size_mm:.0f} mm. This fits a "
                f"{other.category} ({usual:g} to {widest:g} mm) {math.exp(better - log_likelihood):.0f} "
                f"times better than a {prior.category} ({low:g} to {high:g} mm). Correct category in "
                "batch.toml. For a cultivar of unusual size, give your own file as [pit] prior, with "
                "its fruit_mm."
            ),
            relative_sd=E_PER_SIZE * _pit_ratio(prior, other),
        )
    ]


def shipped_categories() -> list[PitPrior]:
    """Those of whole fruit with a pit of their own."""
    return [prior for name in known_categories() if (prior := load_prior(name)).axis_ratios is not None]


def _ln_size(range_mm: tuple[float, float]) -> tuple[float, float]:
    low, high = np.log(range_mm).tolist()
    return (low + high) / 2, (high - low) / (2 * RANGE_SD)


def _log_likelihood(size_mm: float, range_mm: tuple[float, float]) -> float:
    """Of ln size, but for a constant."""
    mean, sd = _ln_size(range_mm)
    return -(((math.log(size_mm) - mean) / sd) ** 2) / 2 - math.log(sd)


def _pit_ratio(prior: PitPrior, other: PitPrior) -> float:
    """|ln| of the ratio of both pits' sizes in equally large fruit; 0 where it is within their spread."""
    if prior.axis_ratios is None or other.axis_ratios is None:
        return 0.0
    ratio = abs(float(np.log(np.prod(prior.axis_ratios) / np.prod(other.axis_ratios)))) / 3
    return ratio if ratio > math.hypot(prior.size_sd, other.size_sd) else 0.0
