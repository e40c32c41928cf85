"""Gauge R&R: how much of the spread of readings comes from grippers or sensors (the appraisers).

Crossed study with parts, appraisers and trials, by analysis of variance (AIAG, Measurement Systems Analysis,
4th ed., 2010, ch. III B). Where the interaction of part and appraiser is not significant at 5 %, it is pooled
with the repeatability. Negative variances count as zero.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import f as fisher

SIGNIFICANT = 0.05
"""Level of the test of the interaction, as AIAG has it."""


@dataclass(frozen=True, kw_only=True)
class GaugeStudy:
    """Standard deviations in the unit of the readings: EV, AV, INT, GRR, PV and TV of the AIAG manual.

    `categories`: number of distinct categories, 1.41 PV / GRR without its decimals; None where GRR is zero.
    """

    repeatability: float
    reproducibility: float
    interaction: float
    gauge: float
    part: float
    total: float
    p_interaction: float
    categories: int | None

    def percent(self, sd: float) -> float:
        """A component as a percentage of the total variation."""
        return 100 * sd / self.total if self.total else 0.0


def gauge_study(readings: Float[np.ndarray, "parts appraisers trials"]) -> GaugeStudy:
    """Of at least two parts, appraisers and trials each."""
    n, k, r = readings.shape
    mean, cells = readings.mean(), readings.mean(axis=2)
    ss_part = k * r * float(((readings.mean(axis=(1, 2)) - mean) ** 2).sum())
    ss_appraiser = n * r * float(((readings.mean(axis=(0, 2)) - mean) ** 2).sum())
    ss_error = float(((readings - cells[:, :, None]) ** 2).sum())
    ss_both = r * float(((cells - mean) ** 2).sum()) - ss_part - ss_appraiser
    df_both, df_error = (n - 1) * (k - 1), n * k * (r - 1)
    ms_part, ms_appraiser = ss_part / (n - 1), ss_appraiser / (k - 1)
    ms_both, ms_error = ss_both / df_both, ss_error / df_error
    p = float(fisher.sf(ms_both / ms_error, df_both, df_error)) if ms_error > 0 else 0.0
    if p > SIGNIFICANT:
        ms_both = ms_error = (ss_both + ss_error) / (df_both + df_error)
    variances = (
        ms_error,
        (ms_appraiser - ms_both) / (n * r),
        (ms_both - ms_error) / r,
        (ms_part - ms_both) / (k * r),
    )
    repeatability, reproducibility, interaction, part = (
        math.sqrt(max(variance, 0.0)) for variance in variances
    )
    gauge = math.hypot(repeatability, reproducibility, interaction)
    return GaugeStudy(
        repeatability=repeatability,
        reproducibility=reproducibility,
        interaction=interaction,
        gauge=gauge,
        part=part,
        total=math.hypot(gauge, part),
        p_interaction=p,
        categories=int(1.41 * part / gauge) if gauge else None,
    )
