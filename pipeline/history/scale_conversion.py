"""From E to the reading of another instrument: a line fitted to fruit of one cultivar that have both.

    reading = b0 + b1 ln E + e

fitted by least squares on the E that was measured, so that it predicts from a measured E (the error of E is
in e). A reading predicted for one more fruit has Student's t interval (Draper and Smith, Applied Regression
Analysis, ch. 3), and none is predicted beyond the moduli that were fitted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import linregress
from scipy.stats import t as student

from pipeline.history.softening import COVERAGE

FEWEST_FRUIT = 8
"""Fruit with both numbers from which a line is fitted: Student's t is 1.94 with six degrees of freedom, a
fifth wider than with many. Set by hand."""
LEAST_SPAN = 0.4
"""Of ln E that the fruit must span, a factor of 1.5 in E: over less a line is of the noise. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class ScaleConversion:
    """reading = intercept + slope ln(E / MPa), of `fruit` fruit with E between E_low_MPa and E_high_MPa.

    `residual_sd`: in the reading's unit. `mean_ln_E`, `squares`: of the fruit fitted, by which the interval
    widens away from their middle.
    """

    scale: str
    group: str
    version: int
    fitted_utc: str
    fruit: int
    intercept: float
    slope: float
    slope_sd: float
    residual_sd: float
    mean_ln_E: float
    squares: float
    E_low_MPa: float
    E_high_MPa: float

    def predicted(self, E_MPa: float) -> tuple[float, float] | None:
        """The reading of one more fruit with this measured E, and half of its 90 % interval; None beyond the
        moduli fitted.
        """
        if not self.E_low_MPa <= E_MPa <= self.E_high_MPa:
            return None
        away = math.log(E_MPa) - self.mean_ln_E
        sd = self.residual_sd * math.sqrt(1 + 1 / self.fruit + away**2 / self.squares)
        half = float(student.ppf(0.5 + COVERAGE / 2, self.fruit - 2)) * sd
        return self.intercept + self.slope * math.log(E_MPa), half


class NotFitted(ValueError):
    """Why a conversion cannot be fitted, a sentence."""


def fitted_conversion(
    E_MPa: Sequence[float], reading: Sequence[float], *, scale: str, group: str, version: int, fitted_utc: str
) -> ScaleConversion:
    """The line through fruit that have both. Raises NotFitted."""
    n = len(E_MPa)
    if n < FEWEST_FRUIT:
        raise NotFitted(
            f"{n} fruit of {group} have both E and {scale}; the fit needs at least {FEWEST_FRUIT}"
        )
    x, y = np.log(np.asarray(E_MPa, dtype=float)), np.asarray(reading, dtype=float)
    if (span := float(np.ptp(x))) < LEAST_SPAN:
        raise NotFitted(
            f"E of the {n} fruit of {group} spans a factor of {math.exp(span):.2f}; the fit needs at "
            f"least {math.exp(LEAST_SPAN):.2f}: add riper or firmer fruit"
        )
    line = linregress(x, y)
    squares = float(((x - x.mean()) ** 2).sum())
    return ScaleConversion(
        scale=scale,
        group=group,
        version=version,
        fitted_utc=fitted_utc,
        fruit=n,
        intercept=float(line.intercept),
        slope=float(line.slope),
        slope_sd=float(line.stderr),
        residual_sd=float(line.stderr) * math.sqrt(squares),
        mean_ln_E=float(x.mean()),
        squares=squares,
        E_low_MPa=float(np.exp(x.min())),
        E_high_MPa=float(np.exp(x.max())),
    )
