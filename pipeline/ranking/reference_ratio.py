"""The gripper's error as measured on the reference bodies of a batch, and its effect on the fruit's moduli.

A gain of force or displacement that both pads share scales every modulus of a batch by one factor. No single
recording shows it, only a body of known modulus does. So the ratio of found to known modulus replaces the
assumed errors of the sensor's scales (pipeline.fruit.sensor_scale). Their spread is no part of the ratio's
error.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from pipeline.batch.records import FruitRecord, ModulusRecord, ReferenceRecord
from pipeline.fruit.input_doubts import DOUBTED
from pipeline.ranking.verified_scale import shared_gain, verified, with_own_gain, without_sensor
from reports.entries import ReferenceBodyEntry
from reports.grasp_record import GraspRecord

WITHIN_SD = 2.0
"""A ratio at most this many standard deviations from 1 counts as 1: a normal gripper is beyond in 5 % of
batches (normal error of ln r)."""
DISAGREE_P = 0.01
"""Bodies disagree if their chi-square is rarer than this by chance: in one normal batch of a hundred."""
MOST_RATIO = 1.5
"""A ratio beyond this, either way, is no gain of a gripper, and drupe divides nothing by it. Errors that a
gripper may have (assumed): calibrated force and displacement by 10 % each, and a gel that wear, warmth or
creep made softer by 30 %. Together they are 1.1 * 1.1 * 1.3 = 1.57 in force over displacement, which is
1.57**0.7 = 1.37 in E (E_PER_GAIN, tactile/consistency/relations.py; more is refused: REFUSED_SD of
finding.py). Typing errors are larger: a factor of 10, or 1.5 to 1.8 for the next body of a set in steps of
Shore A 10 (Gent 1958)."""
PART = "reference body"
"""The part of a corrected error bar that comes from the ratio's error."""
_SCALED = (
    "E_MPa",
    "E_sd_MPa",
    "E_energy_MPa",
    "E_energy_sd_MPa",
    "E_least_squares_MPa",
    "E_least_squares_sd_MPa",
)


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """r = E found / E known: `ratio`, the standard deviation `ln_sd` of ln r, and the bodies' chi-square."""

    ratio: float
    ln_sd: float
    chi2: float = 0.0
    degrees: int = 0
    p_value: float = 1.0

    @property
    def sd(self) -> float:
        """Standard deviation of r, r times that of ln r."""
        return self.ratio * self.ln_sd

    @property
    def from_one_sd(self) -> float:
        """Distance of ln r from 0 in standard deviations."""
        return abs(math.log(self.ratio)) / self.ln_sd

    @property
    def apart(self) -> bool:
        """Whether the gripper misreads the reference's modulus."""
        return self.from_one_sd > WITHIN_SD

    @property
    def implausible(self) -> bool:
        """Whether it is neither 1 nor a gripper's gain: a number or a body is wrong."""
        return self.apart and abs(math.log(self.ratio)) > math.log(MOST_RATIO)

    @property
    def disagree(self) -> bool:
        """Whether the bodies contradict each other."""
        return self.p_value < DISAGREE_P


@dataclass(frozen=True, kw_only=True)
class ReferenceFinding:
    """Joint result of a batch's reference bodies; `ratio` is None if none of them was graded. `gain`: the
    least relative part of their moduli's errors by a gain of the forces that all fruit share.
    """

    bodies: tuple[ReferenceBodyEntry, ...]
    ratio: Ratio | None
    gain: float = 0.0
    corrected: bool
    sentences: tuple[str, ...]

    @property
    def alarm(self) -> bool:
        """Whether staff must do something."""
        if self.ratio is None or self.ratio.disagree:
            return True
        return self.ratio.apart and not self.corrected


def combined_ratio(
    E_found_MPa: Float[np.ndarray, " n"],
    E_found_sd_MPa: Float[np.ndarray, " n"],
    common_sd_MPa: Float[np.ndarray, " n"],
    E_known_MPa: Float[np.ndarray, " n"],
    E_known_sd_MPa: Float[np.ndarray, " n"],
) -> Ratio:
    """The mean of ln(E found / E known) weighted by 1 / variance, with errors of both moduli in the variance.

    `common_sd_MPa`, the part of the found moduli's errors that all share (the elements' size), is kept whole:
    more bodies do not reduce it. If the bodies disagree (chi-square over the n - 1 degrees of freedom rarer
    than DISAGREE_P), the rest is widened by sqrt(chi2 / (n - 1)), the Birge ratio (Birge 1932, Physical
    Review 40:207).
    """
    ln_ratio = np.log(E_found_MPa / E_known_MPa)
    shared = common_sd_MPa / E_found_MPa
    independent_variance = (
        np.maximum((E_found_sd_MPa / E_found_MPa) ** 2 - shared**2, 0) + (E_known_sd_MPa / E_known_MPa) ** 2
    )
    weight = (1 / independent_variance) / (1 / independent_variance).sum()
    mean = float(weight @ ln_ratio)
    chi2, degrees = float((((ln_ratio - mean) ** 2) / independent_variance).sum()), len(ln_ratio) - 1
    p_value = float(chdtrc(degrees, chi2)) if degrees else 1.0
    variance = 1 / float((1 / independent_variance).sum())
    if p_value < DISAGREE_P:
        variance *= max(chi2 / degrees, 1.0)
    return Ratio(
        ratio=math.exp(mean),
        ln_sd=math.hypot(math.sqrt(variance), float(weight @ shared)),
        chi2=chi2,
        degrees=degrees,
        p_value=p_value,
    )


def against_references(
    records: Sequence[FruitRecord], *, correct: bool
) -> tuple[list[FruitRecord], ReferenceFinding | None]:
    """The records as reports show them, and the result of the reference bodies; no finding if there are none.

    The bodies' own records stay. A ratio within 2 standard deviations of 1 changes no fruit. Beyond it every
    graded fruit's E is divided by it (`correct`), or is in doubt, its error bar wider by |ln r|. If the
    bodies contradict each other, nothing is divided, and every E is in doubt by the largest body's |ln r|. A
    ratio that no gripper has (`implausible`) never divides E, whatever `correct` is.
    """
    asked = [record for record in records if record.given.reference]
    if not asked:
        return [record.model_copy(update={"reference": None}) for record in records], None
    moduli = {record.fruit_id: record.modulus for record in asked if record.graded and record.modulus}
    bodies = tuple(_body(record, moduli[record.fruit_id]) for record in asked if record.fruit_id in moduli)
    of_bodies = [
        (body.E_found_MPa, alone.E_sd_MPa, alone.common_sd_MPa, body.E_known_MPa, body.E_known_sd_MPa)
        for body, alone in zip(bodies, map(without_sensor, moduli.values()), strict=True)
    ]
    ratio = combined_ratio(*np.array(of_bodies).T) if bodies else None
    usable = ratio is not None and ratio.apart and not (ratio.disagree or ratio.implausible)
    corrected = correct and usable
    finding = ReferenceFinding(
        bodies=bodies,
        ratio=ratio,
        gain=min(map(shared_gain, moduli.values()), default=0.0),
        corrected=corrected,
        sentences=tuple(_sentences(bodies, asked, ratio, corrected=corrected)),
    )
    return [_with_reference(record, finding) for record in records], finding


def as_measured(record: FruitRecord, corrected: FruitRecord) -> FruitRecord:
    """The record as stored: its own modulus as measured, with what the reports show of it."""
    return record.model_copy(update={"reference": corrected.reference, "temperature": corrected.temperature})


def _body(record: FruitRecord, modulus: ModulusRecord) -> ReferenceBodyEntry:
    known, sd = record.given.reference_E_MPa, record.given.reference_E_sd_MPa
    if known is None or sd is None:
        raise ValueError(f"drupe graded the reference body {record.fruit_id} without its modulus")
    ratio = modulus.E_MPa / known
    return ReferenceBodyEntry(
        fruit_id=record.fruit_id,
        E_known_MPa=known,
        E_known_sd_MPa=sd,
        E_found_MPa=modulus.E_MPa,
        E_found_sd_MPa=modulus.E_sd_MPa,
        ratio=ratio,
        ratio_sd=ratio * math.hypot(without_sensor(modulus).E_sd_MPa / modulus.E_MPa, sd / known),
    )


def _ratio_of(body: ReferenceBodyEntry) -> Ratio:
    return Ratio(ratio=body.ratio, ln_sd=body.ratio_sd / body.ratio)


def _sentences(
    bodies: Sequence[ReferenceBodyEntry],
    asked: Sequence[FruitRecord],
    ratio: Ratio | None,
    *,
    corrected: bool,
) -> list[str]:
    if ratio is None:
        why = ", ".join(f"{record.fruit_id}: {record.outcome}" for record in asked)
        return [
            f"No reference body is graded ({why}), so drupe cannot check a gain common to both pads; "
            "correct the cause and run the batch again."
        ]
    if ratio.implausible and not ratio.disagree:
        return [f"{_implausible(ratio, bodies)} Every E of the batch is in doubt, and drupe corrects none."]
    said = [f"{_reads(ratio, bodies)}: {_verdict(ratio, corrected=corrected)}"]
    if ratio.disagree:
        each = ", ".join(f"{body.fruit_id} {_with_sd(_ratio_of(body))}" for body in bodies)
        said.append(
            f"The reference bodies disagree beyond their errors (chi-square {ratio.chi2:.3g} on "
            f"{ratio.degrees} degree{'s' if ratio.degrees > 1 else ''} of freedom, p = "
            f"{ratio.p_value:.1g}): {each}. Check whether one has another modulus than fruits.csv "
            "gives, or a poor grasp. The mean's error includes the disagreement."
        )
    return said


def _reads(ratio: Ratio, bodies: Sequence[ReferenceBodyEntry]) -> str:
    names = ", ".join(body.fruit_id for body in bodies)
    whose = "the reference body" if len(bodies) == 1 else f"{len(bodies)} reference bodies"
    return f"The gripper reads {_with_sd(ratio)} times the known modulus of {whose} ({names})"


def _implausible(ratio: Ratio, bodies: Sequence[ReferenceBodyEntry]) -> str:
    """Likelier causes than such a gain, typing errors first."""
    typed = ", ".join(
        f"reference_E_MPa = {body.E_known_MPa:g} MPa of {body.fruit_id}"
        for body in bodies
        if _ratio_of(body).implausible
    )
    return (
        f"{_reads(ratio, bodies)}, but a working gripper deviates by a factor of {MOST_RATIO:g} at "
        f"most. Check {typed} for typing errors, the recordings of that body, and the stated gels and "
        "units."
    )


def _verdict(ratio: Ratio, *, corrected: bool) -> str:
    """The end of the sentence about the ratio: whether it is as expected, and what follows."""
    if ratio.disagree:
        return (
            "drupe cannot judge the gripper, because the reference bodies contradict each other; "
            "every E of the batch is in doubt, and drupe corrects none."
        )
    if not ratio.apart:
        return f"within {WITHIN_SD:g} standard deviations of 1, as expected."
    far = f"{ratio.from_one_sd:.1f} standard deviations from 1"
    if corrected:
        return f"{far}; drupe divides every fruit's E by it ([reference] correct = true)."
    return (
        f"{far}; every E of the batch is in doubt. Calibrate gels and gripper again, or set "
        "[reference] correct = true in batch.toml to divide every E by it."
    )


def _with_sd(ratio: Ratio) -> str:
    """To two decimals, or as many as its standard deviation needs.

    >>> _with_sd(Ratio(ratio=1.12, ln_sd=0.03)), _with_sd(Ratio(ratio=1.0, ln_sd=0.004))
    ('1.12 ± 0.03', '1.000 ± 0.004')
    """
    places = max(2, math.ceil(-math.log10(ratio.sd))) if 0 < ratio.sd < 1 else 2
    return f"{ratio.ratio:.{places}f} ± {ratio.sd:.{places}f}"


def _with_reference(record: FruitRecord, finding: ReferenceFinding) -> FruitRecord:
    """A fruit's record with the reference bodies' ratio: its E divided by it, doubted, or unchanged."""
    ratio, modulus = finding.ratio, record.modulus
    if record.given.reference or not record.graded or modulus is None or ratio is None:
        return record.model_copy(update={"reference": None})
    modulus = with_own_gain(modulus, finding.gain)
    changed: dict[str, object] = {}
    if finding.corrected:
        modulus = corrected_modulus(modulus, ratio)
        changed["grasps"] = tuple(scaled_grasp(grasp, ratio.ratio) for grasp in record.grasps)
    elif ratio.disagree or ratio.apart:
        sentence, off = _doubt(ratio, finding.bodies), abs(math.log(ratio.ratio))
        if ratio.disagree:
            off = max(abs(math.log(body.ratio)) for body in finding.bodies)
        if not (ratio.disagree or ratio.implausible):
            modulus = verified(modulus, 0.0, ratio.ln_sd)  # the doubt includes |ln r| itself
        modulus = modulus.widened(DOUBTED, off * modulus.E_MPa, shared=True)
        changed["doubts"] = (*record.doubts, sentence)
        changed["warnings"] = (sentence, *record.warnings)
    else:
        modulus = verified(modulus, math.log(ratio.ratio), ratio.ln_sd)
    reference = ReferenceRecord(
        bodies=tuple(body.fruit_id for body in finding.bodies),
        ratio=ratio.ratio,
        ratio_sd=ratio.sd,
        corrected=finding.corrected,
        E_MPa=modulus.E_MPa,
        E_sd_MPa=modulus.E_sd_MPa,
        E_scale_sd_MPa=modulus.scale_sd_MPa,
    )
    return record.model_copy(update={**changed, "modulus": modulus, "reference": reference})


def _doubt(ratio: Ratio, bodies: Sequence[ReferenceBodyEntry]) -> str:
    """The doubt of every fruit of the batch if the ratio is wrong and not corrected."""
    if ratio.disagree:
        names = ", ".join(f"{body.fruit_id} {_with_sd(_ratio_of(body))}" for body in bodies)
        return f"drupe cannot judge the gripper: the reference bodies contradict each other ({names})."
    if ratio.implausible:
        said = _implausible(ratio, bodies)
        return f"{said[:1].lower()}{said[1:]} drupe does not correct E for it."
    said = _reads(ratio, bodies)
    return f"{said[:1].lower()}{said[1:]}, and drupe does not correct E for it."


def corrected_modulus(modulus: ModulusRecord, ratio: Ratio) -> ModulusRecord:
    """E / r with sd^2 = (sd / r)^2 + (E / r * sd of ln r)^2, the second part common to all fruit.

    The ratio replaces the sensor's errors that all fruit share (verified_scale.SHARED).
    """
    corrected = without_sensor(modulus).scaled(1 / ratio.ratio)
    return corrected.widened(PART, corrected.E_MPa * ratio.ln_sd, shared=True)


def scaled_grasp(grasp: GraspRecord, ratio: float) -> GraspRecord:
    """One recording's moduli divided by `ratio`, as the fruit's, and those of its frames."""
    known = {name: getattr(grasp, name) for name in _SCALED}
    changed = {name: value / ratio for name, value in known.items() if value is not None}
    frames = [
        frame.model_copy(update={"E_MPa": frame.E_MPa / ratio, "E_sd_MPa": frame.E_sd_MPa / ratio})
        for frame in grasp.frames
    ]
    return grasp.model_copy(update=changed | {"frames": frames})
