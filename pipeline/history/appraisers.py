"""Compares grippers or sensors on lots that several measured on one day, and on the same fruit or bodies.

Gauge R&R states how much of the spread of readings comes from grippers or sensors (the appraisers). It is a
crossed study with parts, appraisers and trials, by analysis of variance (AIAG, Measurement Systems Analysis,
4th ed., 2010, ch. III B). An interaction of part and appraiser that is not significant at 5 % is pooled with
the repeatability. Negative variances count as zero.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.stats import f as fisher
from scipy.stats import ttest_1samp

from pipeline.history.softening import COVERAGE
from pipeline.history.stored_batch import StoredBatch, StoredFruit
from reports.history_entries import GaugeEntry

FEWEST_DAYS = 3
"""Fewest common lots and days for a comparison of two grippers or sensors. Student's t of two is 6.3, wider
than any difference that matters. Set by hand."""
SIGNIFICANT = 0.05
"""Significance level of the test of the interaction (AIAG)."""
NameOf = Callable[[StoredBatch], str]


def gripper_of(batch: StoredBatch) -> str:
    """Name and serial number; empty if the settings state neither."""
    return " ".join(filter(None, (batch.gripper, batch.gripper_serial)))


def sensor_of(batch: StoredBatch) -> str:
    """Name, serial number and calibration; empty if the settings state none."""
    on = f"of {batch.calibrated_on}" if batch.calibrated_on else ""
    return " ".join(filter(None, (batch.sensor, batch.sensor_serial, batch.calibration, on)))


APPRAISERS: dict[str, NameOf] = {"gripper": gripper_of, "sensor": sensor_of}


def comparisons(batches: Sequence[StoredBatch]) -> Iterable[str]:
    """Sentences on the difference of each pair in the mean of ln E, over lots and days that both measured.

    The paired t test takes the differences of lots and days as its sample: between days, the parts of a lot
    differ by more than fruit do.
    """
    for kind, named in APPRAISERS.items():
        readings = [
            (*batch.series, batch.measured, named(batch), math.log(fruit.E_MPa))
            for batch in batches
            for fruit in batch.fruit
            if fruit.fitted and named(batch)
        ]
        columns = ["category", "cultivar", "lot", "day", "appraiser", "ln_E"]
        means = pd.DataFrame(readings, columns=columns).pivot_table("ln_E", columns[:4], "appraiser")
        for first, second in combinations(means.columns, 2):
            differences = (means[second] - means[first]).dropna()
            if len(differences) < FEWEST_DAYS:
                continue
            test = ttest_1samp(differences, 0.0)
            interval = test.confidence_interval(COVERAGE)
            middle, low, high = (
                100 * math.expm1(x) for x in (np.mean(differences), interval.low, interval.high)
            )
            yield (
                f"{kind} {second} reads {middle:+.1f} % ({low:+.1f} to {high:+.1f} %, 90 %; "
                f"p = {test.pvalue:.2g}) against {kind} {first}, over {len(differences)} lots and days"
            )


@dataclass(frozen=True, kw_only=True)
class GaugeStudy:
    """Standard deviations in the unit of the readings: EV, AV, INT, GRR, PV and TV of the AIAG manual.

    `categories`: number of distinct categories, 1.41 PV / GRR rounded down; None if GRR is zero.
    """

    repeatability: float
    reproducibility: float
    interaction: float
    gauge: float
    part: float
    total: float
    categories: int | None

    def percent(self, sd: float) -> float:
        """A component as a percentage of the total variation."""
        return 100 * sd / self.total if self.total else 0.0

    @property
    def words(self) -> str:
        """Share of the gauge in the total variation, and the categories if they are known."""
        share = f"gauge R&R is {self.percent(self.gauge):.1f} % of the total variation"
        return share if self.categories is None else f"{share}; distinct categories: {self.categories}"


def gauge_study(readings: Float[np.ndarray, "parts appraisers trials"]) -> GaugeStudy:
    """The study of readings of at least two parts, appraisers and trials."""
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
        categories=int(1.41 * part / gauge) if gauge else None,
    )


def gauge_entry(batches: Sequence[StoredBatch], kind: str) -> GaugeEntry | str:
    """The study of all parts that each gripper (or sensor) measured at least twice; else why there is none.

    Fruit with one id, lot and day count as the same fruit, reference bodies with one id as the same body.
    Readings are ln E of single grasps, oldest first; the part with the fewest sets the number of trials.
    """
    by_part: dict[tuple[object, ...], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for batch in sorted(batches, key=lambda batch: (batch.measured, batch.graded_utc)):
        if appraiser := APPRAISERS[kind](batch):
            for fruit in batch.fruit:
                if not fruit.doubted:
                    by_part[_part(batch, fruit)][appraiser] += _readings(fruit)
    names = sorted({appraiser for part in by_part.values() for appraiser in part})
    parts = [
        part for part in by_part.values() if all(len(part.get(appraiser, ())) > 1 for appraiser in names)
    ]
    if len(names) < 2 or len(parts) < 2:
        return (
            f"--gauge {kind}: found {len(names)} {kind}s, and {len(parts)} fruit or reference bodies that "
            f"each measured at least twice; expected two of both. Grasp the same fruit with every {kind} at "
            "least twice on one day, under the same ids and lot"
        )
    trials = min(len(part[appraiser]) for part in parts for appraiser in names)
    readings = np.array([[part[appraiser][:trials] for appraiser in names] for part in parts])
    study = gauge_study(readings)
    bias = np.expm1(readings.mean(axis=(0, 2)) - readings.mean())
    components = (
        ("repeatability (EV)", study.repeatability),
        (f"reproducibility of {kind}s (AV)", study.reproducibility),
        ("interaction with fruit (INT)", study.interaction),
        ("gauge R&R (GRR)", study.gauge),
        ("fruit (PV)", study.part),
        ("total (TV)", study.total),
    )
    return GaugeEntry(
        kind=kind,
        words=f"{len(parts)} fruit or bodies, {len(names)} {kind}s, {trials} trials: {study.words}",
        components=tuple((name, 100 * sd, study.percent(sd)) for name, sd in components),
        biases=tuple(
            (name, 100 * float(relative_bias)) for name, relative_bias in zip(names, bias, strict=True)
        ),
    )


def _part(batch: StoredBatch, fruit: StoredFruit) -> tuple[object, ...]:
    if fruit.E_known_MPa is not None:
        return (fruit.fruit_id,)
    return (*batch.series, batch.measured, fruit.fruit_id)


def _readings(fruit: StoredFruit) -> list[float]:
    single = [grasp.E_MPa for grasp in fruit.grasps if grasp.E_MPa is not None and grasp.E_MPa > 0]
    return [math.log(E) for E in (single or [fruit.E_MPa])]
