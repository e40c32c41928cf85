"""Faults that all fruit of a batch have in common: of a sensor or the jaws, not of the fruit.

For every fruit the screen gives the amount y_i of each effect that belongs to a sensor or the jaws, with its
standard deviation s_i. A random-effects model combines them over fruit,

    y_i ~ N(mu, s_i^2 + tau^2),      mu = sum w_i y_i / sum w_i,      w_i = 1 / (s_i^2 + tau^2)

tau is the spread between fruit (DerSimonian and Laird 1986, "Meta-analysis in clinical trials", Controlled
Clinical Trials 7). A few fruit say little about it, so that it is moderated by prior knowledge, FLOOR with
PRIOR_FREEDOM degrees of freedom (Smyth 2004, "Linear models and empirical Bayes methods", Statistical
Applications in Genetics and Molecular Biology 3). The error of mu is that of Hartung and Knapp (2001,
Statistics in Medicine 20), moderated in the same way,

    sd^2 = max(1, q) / sum w_i,      q the mean of w_i (y_i - mu)^2

and t = (|mu| - FLOOR) / sd is compared with Student's t with k - 1 + PRIOR_FREEDOM degrees of freedom. FLOOR
is also the amount that the model's own error may mimic in all fruit. Every amount is one test. All tests
share the level FALSE_ALARM (Bonferroni), which limits the share of faultless batches with a reported fault.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.special import stdtr

from fem.mismatch.catalogue import SPECS
from pipeline.batch.records import FruitRecord
from pipeline.batch.rig_setting import rig_path
from pipeline.batch.settings import Settings
from tactile.readers.rig_file import read_rig
from tactile.tactile_failure import TactileFailure


def old_calibrations(root: Path, settings: Settings, *, graded_on: date) -> Iterator[str]:
    """A sentence for each calibration without a date, older than the limit, or later than the grasps; none
    without a limit.
    """
    if (most_days := settings.calibration_days) is None:
        return
    day = settings.measured_on or graded_on
    for what, field, file, made, again in _calibrations(root, settings):
        if made is None:
            yield (
                f"The {what} has no date: `{field}` in {file} is missing, but calibration_days in batch.toml "
                "limits its age. Add the day of the calibration."
            )
        elif made > day:
            yield (
                f"The {what} is dated after the grasps: `{field}` in {file} is {made}, expected at most "
                f"{day}. Correct it, or measured_on in batch.toml."
            )
        elif (days := (day - made).days) > most_days:
            yield (
                f"The {what} is too old: `{field}` in {file} is {made}, {days} days before the grasps "
                f"({day}), expected at most {most_days} days (calibration_days in batch.toml). {again}"
            )


def _calibrations(root: Path, settings: Settings) -> Iterator[tuple[str, str, str, date | None, str]]:
    """Each calibration that the settings name: what, field of its date, file, date, what to do again."""
    sensor, path = settings.sensor, rig_path(root, settings)
    if sensor is not None and sensor.calibrated:
        again = "Calibrate the sensor again (drupe calibrate), and correct calibrated_on."
        yield "calibration of the sensor", "calibrated_on", "batch.toml", sensor.calibrated_on, again
    try:
        rig = None if path is None else read_rig(path)
    except TactileFailure:  # grading reports it
        return
    if path is not None and rig is not None:
        again = "Calibrate the rig again (drupe calibrate --rigid)."
        yield "calibration of the rig", "made", path.name, rig.made, again


FALSE_ALARM = 0.01
"""Largest share of faultless batches in which a fault is reported: one in a hundred, as somebody has to stop
and calibrate. Simulated ones, whose fruit differ by more than their errors, stay below it
(tests/pipeline/test_doubts.py)."""
FEWEST = 3
"""Fewest fruit: with two nobody can separate what is common from what differs."""
FLOOR: dict[str, float] = {
    "gain": 0.006,
    "newton_per_s": 0.008,
    "mm_per_N": 0.015,
    "lag_s": 0.002,
    "shift_mm.0": 0.6,
    "shift_mm.1": 0.6,
    "tilt_deg": 0.35,
    "a": 0.03,
    "creep": 0.03,
    "share": 0.01,
}
"""By parameter, in its own unit (mm, N/s, mm/N, s, degrees; shares and ratios): amounts that the model's
error may mimic. The four normal fruit of the sample batch show gains of 0.004, 0.000, -0.013 and 0.009. Gels
without a fault show 0.011 of `a`, 0.016 of `creep` and 0.008 of `share` at most; gels whose markers move
their neighbours 0.028 of `a` (simulated). The others are two to three times the error of such effects
(benchmarks/results/mismatch.csv)."""
PRIOR_FREEDOM = 4
"""Degrees of freedom of that prior. With 3 to 5 the stated rate holds while fruit differ by up to three times
FLOOR. A gain of 4 % in four fruit is then found (tests/pipeline/test_doubts.py)."""
OF_ITS_OWN = 2.0
"""Floor of parameters without a FLOOR, in standard deviations of the median fruit. Set by hand."""
SEEN = 2.0
"""Standard deviations of its own beyond which a fruit alone shows the fault."""
AS_SURE = 0.5
"""Share of the surest pad's t above which the other pad may be at fault as well. Set by hand: two pads on the
same fruit show only the ratio of their forces."""


@dataclass(frozen=True, kw_only=True)
class Combined:
    """mu, its standard deviation, tau, t, and the p-value of |mu| <= floor (two sides)."""

    mean: float
    sd: float
    between_sd: float
    t: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class BatchFault:
    """One fault of the whole batch: its effect, its pad (empty: the gripper), its amount; the fruit that show
    it by themselves, and the number of fruit tested. `sentence`: all of it for staff.
    """

    effect: str
    pad: str
    parameter: str
    value: float
    sd: float
    between_sd: float
    p_value: float
    shown_by: tuple[str, ...]
    fruit: int
    sentence: str = ""


def combined(
    values: Float[np.ndarray, " k"], sds: Float[np.ndarray, " k"], *, floor: float = 0.0
) -> Combined:
    """Amounts of k fruit, combined.

    >>> found = combined(np.array([0.04, 0.042, 0.038, 0.04]), np.full(4, 0.003), floor=0.006)
    >>> f"{found.mean:.3f} {found.p_value < 0.01}"
    '0.040 True'
    """
    weight = sds**-2.0
    mean = weight @ values / weight.sum()
    excess = weight @ (values - mean) ** 2 - (len(values) - 1)
    tau2 = max(0.0, excess / (weight.sum() - (weight**2).sum() / weight.sum()))
    freedom = len(values) - 1 + PRIOR_FREEDOM
    tau2 = (PRIOR_FREEDOM * floor**2 + (len(values) - 1) * tau2) / freedom
    weight = 1 / (sds**2 + tau2)
    mean = float(weight @ values / weight.sum())
    spread = (PRIOR_FREEDOM + float(weight @ (values - mean) ** 2)) / freedom
    sd = math.sqrt(max(1.0, spread) / weight.sum())
    ratio = max(0.0, abs(mean) - floor) / sd
    return Combined(
        mean=mean, sd=sd, between_sd=math.sqrt(tau2), t=ratio, p_value=float(2 * stdtr(freedom, -ratio))
    )


def batch_faults(records: Sequence[FruitRecord]) -> tuple[BatchFault, ...]:
    """Faults of sensors or jaws in the whole batch, the surest first; at most one of each effect."""
    amounts: dict[tuple[str, str, str], list[tuple[str, float, float]]] = {}
    for record in records:
        for amount in () if record.screen is None else record.screen.amounts:
            if math.isfinite(amount.value) and amount.sd > 0:
                key = (amount.effect, amount.pad, amount.parameter)
                amounts.setdefault(key, []).append((record.fruit_id, amount.value, amount.sd))
    tried = {
        key: of_fruit for key, of_fruit in amounts.items() if len(of_fruit) >= FEWEST and key[0] in SPECS
    }
    sure: list[tuple[float, BatchFault]] = []
    for (effect, pad, parameter), of_fruit in tried.items():
        values, sds = (np.array(numbers) for numbers in list(zip(*of_fruit, strict=True))[1:])
        together = combined(values, sds, floor=FLOOR.get(parameter, OF_ITS_OWN * float(np.median(sds))))
        if together.p_value < FALSE_ALARM / len(tried):
            fault = BatchFault(
                effect=effect,
                pad=pad,
                parameter=parameter,
                value=together.mean,
                sd=together.sd,
                between_sd=together.between_sd,
                p_value=together.p_value,
                shown_by=tuple(
                    name for name, y, s in of_fruit if y * together.mean > 0 and abs(y) > SEEN * s
                ),
                fruit=len(of_fruit),
            )
            sure.append((together.t, fault))
    by_effect: dict[str, list[tuple[float, BatchFault]]] = {}
    for t, fault in sorted(sure, key=lambda known: known[1].p_value):
        by_effect.setdefault(fault.effect, []).append((t, fault))
    return tuple(_surest(known) for known in by_effect.values())


def _surest(known: Sequence[tuple[float, BatchFault]]) -> BatchFault:
    """The surest fault of one effect, with the other pads that may have it instead: what is wrong, by how
    much, in how many fruit, and what to do.
    """
    (most, first), *rest = sorted(known, key=lambda candidate: -candidate[0])
    others = [
        fault
        for t, fault in rest
        if fault.pad != first.pad and fault.parameter == first.parameter and t > AS_SURE * most
    ]
    words = ", or ".join(map(_amount, (first, *others)))
    return replace(
        first,
        sentence=f"{words[:1].upper()}{words[1:]}: in all {first.fruit} fruit together (p = "
        f"{first.p_value:.1g}), and visible in {len(first.shown_by)} of {first.fruit} individually. "
        f"{SPECS[first.effect].words.advice}",
    )


def _amount(fault: BatchFault) -> str:
    """The fault with its size."""
    where = f"the {fault.pad} pad" if fault.pad else "the gripper"
    if fault.parameter == "gain":
        gain = 1 / (1 - fault.value) - 1
        much = "much" if gain > 0 else "little"
        sd = 100 * fault.sd / (1 - fault.value) ** 2
        return f"{where} reads {100 * abs(gain):.1f} ± {sd:.1f} % too {much} force"
    specs = SPECS[fault.effect].parameters
    spec = next((spec for spec in specs if fault.parameter in {part.name for part in spec.searched}), None)
    unit = "" if spec is None else f" {spec.unit}".replace(" 1", "")
    meaning = SPECS[fault.effect].words.short if spec is None else spec.words
    axis = {"0": " along its x", "1": " along its y"}.get(fault.parameter.partition(".")[2], "")
    return f"{where}: {meaning}{axis} {fault.value:+.3g} ± {fault.sd:.2g}{unit}"
