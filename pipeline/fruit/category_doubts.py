"""Does the mesh have the size that staff measured, and that of its category's fruit? Is Poisson's ratio the
category's?
"""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.batch.fruits_table import Given
from pipeline.batch.records import MeshRecord
from pipeline.batch.settings import Settings
from pipeline.fruit.input_doubts import E_PER_SIZE, CategoryKind, Doubt
from recon.pit.priors import STONE_FRUIT, PitBody, PitPrior, known_categories, load_prior

FAR_SD = 3.0
"""Standard deviations from the category's Poisson's ratio, beyond which one of the two is wrong."""
E_PER_NU = 1.0
"""Error of ln E per unit of Poisson's ratio: 0.14 at 0.30 for 0.45 (benchmarks/field_mistakes.py --grade)."""
RANGE_SD = 3.0
"""Standard deviations of ln size from the middle of a category's range to either end: both ends are wider
than fruit on sale."""
UNUSUAL_SD = 1.645
"""Standard deviations of ln size that one in ten of a category's fruit exceeds."""
BETTER = 6.0
"""Likelihood of a size in another category over that in its own, above which the other is named (set by hand:
a plum of 57 mm has 6 as a nectarine; up to 56 mm there is no doubt)."""

CALLIPER_SD_MM = 0.2
"""Standard deviation, mm, of a diameter taken by calliper on soft skin (estimate)."""
LEAST_APART_MM = 0.7
"""mm: below it a stem or a leaning fruit explains the difference (estimate)."""
LEAST_APART = 0.02
"""Share of the measured size below which the same holds (estimate)."""


def size_doubts(
    given: Given,
    mesh: MeshRecord,
    prior: PitPrior | None,
    *,
    on_mat: bool,
    by_coin: bool = False,
    body: PitBody = STONE_FRUIT,
) -> list[str]:
    """Sentences where height, diameter or mass of fruits.csv, or the category, contradict the mesh.

    A length contradicts the mesh if both differ by more than three standard deviations, by more than 2 %, and
    by more than 0.7 mm. The standard deviation is that of calliper, surface and scale together. A size
    without a second source gets a sentence too.
    """
    wrong = []
    checked = on_mat or mesh.source == "fruit.ply"
    narrow, wide = sorted(mesh.box_mm[:2])
    for name, by_hand, low, high, what in (
        ("height_mm", given.height_mm if checked else None, mesh.height_mm, mesh.height_mm, "high"),
        ("diameter_mm", given.diameter_mm, narrow, wide, "wide"),
    ):
        apart = 0.0 if by_hand is None else max(low - by_hand, by_hand - high, 0.0)
        if by_hand is not None and apart > tolerance_mm(by_hand, mesh):
            length = f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"
            wrong.append(
                f"The mesh is {length} mm {what}, but fruits.csv says {name} {by_hand:g} "
                f"({100 * apart / by_hand:.1f} % difference)"
            )
    density = None if given.mass_g is None else 1000 * given.mass_g / mesh.volume_mm3
    least, most = body.density_g_per_cm3
    if density is not None and not least <= density <= most:
        wrong.append(
            f"The mesh holds {mesh.volume_mm3 / 1000:.1f} cm³ and fruits.csv says mass_g "
            f"{given.mass_g:g}: the density would be {density:.2f} g/cm³, expected {least:.2f} to "
            f"{most:.2f}"
        )
    size = float(np.cbrt(np.prod(mesh.box_mm)))
    if (
        prior is not None
        and prior.fruit_mm is not None
        and not prior.fruit_mm[0] <= size <= prior.fruit_mm[1]
    ):
        low, high = prior.fruit_mm
        wrong.append(
            f"The mean size of the mesh is {size:.1f} mm; a {prior.category} has {low:g} to {high:g} mm"
        )
    if mesh.source == "fruit.ply":
        check = "check the units (mm, g), and that the mesh is in mm, with z up, and of this fruit."
    elif on_mat:
        check = (
            "check the units (mm, g), the photos of this fruit, and the mat. mat.json must describe the "
            "mat as it was printed (its 100 mm bar must measure 100 mm)."
        )
    else:
        check = (
            f"check the units (mm, g), the photos of this fruit, and height_mm ({given.height_mm:g}), "
            "which scales the mesh."
        )
    doubts = [f"{doubt}: {check}" for doubt in wrong]
    if not checked and not by_coin and given.diameter_mm is None and given.mass_g is None:
        doubts.append(
            f"The size depends on height_mm ({given.height_mm:g}) alone; an error of one percent "
            "changes the volume by three. To detect errors, fill diameter_mm or mass_g, use a coin "
            "([photos] coin), or use the mat."
        )
    return doubts


def tolerance_mm(measured_mm: float, mesh: MeshRecord) -> float:
    """Difference of calliper and mesh up to which neither is considered wrong."""
    scale_sd = mesh.scale_sd if mesh.scale_sd is not None and np.isfinite(mesh.scale_sd) else 0.0
    sd = np.sqrt(CALLIPER_SD_MM**2 + (mesh.surface_sd_mm or 0.0) ** 2 + (scale_sd * measured_mm) ** 2)
    return float(max(3 * sd, LEAST_APART_MM, LEAST_APART * measured_mm))


def of_poisson_ratio(settings: Settings, prior: PitPrior | None) -> list[Doubt]:
    """A doubt about a ratio in batch.toml that is more than FAR_SD from the category's, with errors of
    both."""
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
    """A doubt about a size that is unusual in the fruit's category and fits one of the `others` better, whose
    pit differs.

    The size is the cube root of the volume of the mesh's box. Its logarithm is assumed normal in each
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
    """Priors of shipped categories with a pit."""
    return [prior for name in known_categories() if (prior := load_prior(name)).axis_ratios is not None]


def _ln_size(range_mm: tuple[float, float]) -> tuple[float, float]:
    low, high = np.log(range_mm).tolist()
    return (low + high) / 2, (high - low) / (2 * RANGE_SD)


def _log_likelihood(size_mm: float, range_mm: tuple[float, float]) -> float:
    """Of ln size, up to a constant."""
    mean, sd = _ln_size(range_mm)
    return -(((math.log(size_mm) - mean) / sd) ** 2) / 2 - math.log(sd)


def _pit_ratio(prior: PitPrior, other: PitPrior) -> float:
    """|ln| of the ratio of both pits' sizes in equally large fruit; 0 if within their spread."""
    if prior.axis_ratios is None or other.axis_ratios is None:
        return 0.0
    ratio = abs(float(np.log(np.prod(prior.axis_ratios) / np.prod(other.axis_ratios)))) / 3
    return ratio if ratio > math.hypot(prior.size_sd, other.size_sd) else 0.0
