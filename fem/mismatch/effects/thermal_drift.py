"""`thermal_drift`: gels warm up, swell in their plane, and their normal force drifts, equally in all pads.

    d_recorded = d + strain_per_root_s (sqrt(t) - s0) (x, y, 0)
    f_recorded = f + N_per_root_s (sqrt(t) - s0) / markers

t: time since the recording began; s0: mean of sqrt(t) over the no-contact frames before the contact, which
give the offsets; x, y: the marker's place from the middle of the pad. The heat that enters a thick layer
through one face grows as sqrt(t) (Carslaw and Jaeger 1959, Conduction of Heat in Solids, chapter 2.5). It
appears without contact: as strain at markers outside the contact and in no-contact frames before and after
it. The strain distinguishes it from `sensor_drift`: one pad's force alone, linear in time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.estimation.coloured_noise import variance_inflation
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.evidence.gel_relation import GelRecord, RelationFit, gel_records
from fem.mismatch.gel_fault import GelFault, drift_between
from fem.mismatch.model.case_model import CaseModel

STRAIN, FORCE = "strain_per_root_s", "N_per_root_s"
PRIOR_SD = {STRAIN: 2e-3, FORCE: 0.3}
"""1/sqrt(s) and N/sqrt(s): the third level of samples/mismatch/injected.py."""
FEWEST_APART = 8
"""Least number of a pad's markers that never touch for a fit to these alone. Set by hand, as that of firm
markers (fem.mismatch.evidence.gel_relation)."""
REMEMBERED = 3e-3
"""Share of the largest force and displacement that may remain in a gel after unloading, as in
fem.estimation.zero_drift."""
SURE = 4.0
"""Standard deviations by which a strain must differ from zero."""

SPEC = EffectSpec(
    name="thermal_drift",
    rank=230,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="the gels of the pads warm up: they swell and their forces wander",
        meaning="Markers that touch nothing move outwards and the forces grow, fast at first, as the square "
        "root of time: the sensor has not reached its temperature.",
        advice="Let the sensor warm up before grading and zero it before every grasp. Apply the effect to "
        "the recordings made so far.",
    ),
    parameters=(
        EffectParameter(
            STRAIN,
            "1/√s",
            "strain of the gel's face over the square root of time",
            limits=(-1.0, 1.0),
            low=-0.02,
            high=0.02,
        ),
        EffectParameter(
            FORCE,
            "N/√s",
            "growth of each pad's normal force over the square root of time",
            limits=(-1e3, 1e3),
            low=-5.0,
            high=5.0,
        ),
    ),
    correction=Correction.THERMAL_DRIFT,
    knows_time=True,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


@dataclass(frozen=True)
class Warming:
    """The law of the module."""

    def recorded(self, true: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """With swelling and drift of force."""
        return _swollen(true, values, 1.0)

    def undone(self, recorded: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """Without both."""
        return _swollen(recorded, values, -1.0)


def _swollen(record: GelRecord, values: Mapping[str, float], sign: float) -> GelRecord:
    root = sign * root_of_time(record)[:, None, None]
    even = np.zeros((1, 1, 3))
    even[..., 2] = values[FORCE] / record.markers
    return replace(
        record,
        displacement_mm=record.displacement_mm + values[STRAIN] * root * _outward(record),
        force_N=record.force_N + root * even,
    )


def root_of_time(record: GelRecord) -> Float[np.ndarray, " t"]:
    """sqrt(t) - s0 of the module's docstring."""
    root = np.sqrt(record.time_s - record.time_s[0])
    touched = np.flatnonzero(~record.air)
    before = root[: max(int(touched[0]) - 1, 1)] if len(touched) else root
    return np.asarray(root - before.mean())


def _outward(record: GelRecord) -> Float[np.ndarray, "n 3"]:
    """x, y, 0."""
    return np.asarray(record.rest_mm * np.array([1.0, 1.0, 0.0]))


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(GelFault):
    """The effect, measured without contact instead of by force against displacement."""

    @property
    def of_the_relation(self) -> bool:
        """False: it appears without contact."""
        return False

    def records(self, model: CaseModel) -> tuple[GelRecord, ...]:
        """As recorded: the drift of the force belongs to the effect."""
        return gel_records(model)

    def fitted(self, model: CaseModel, records: Sequence[GelRecord]) -> RelationFit | None:
        """Both rates, by `still_pads`."""
        return still_pads(records)


def still_pads(records: Sequence[GelRecord]) -> RelationFit | None:
    """Both rates, common to all pads, from no-contact frames; None if the strain is not significant.

    Uses markers that never touch if there are FEWEST_APART: a pressed gel may keep a residual deformation.
    """
    weight, right, chi2, count = np.zeros(2), np.zeros(2), 0.0, 0
    for record in records:
        if not record.air.any():
            continue
        root = root_of_time(record)[record.air]
        chosen = ~record.ever if (~record.ever).sum() >= FEWEST_APART else np.ones_like(record.ever)
        white = float(variance_inflation(np.array([record.lag1]))[0])
        outward = root[:, None, None] * _outward(record)[chosen, :2]
        moved = record.displacement_mm[record.air][:, chosen, :2]
        noise = record.displacement_sd_mm**2 * white
        size = float((outward**2).sum())
        remembered = REMEMBERED * float(np.abs(record.displacement_mm[..., :2]).max())
        width = float(np.abs(_outward(record)[chosen]).max()) * max(float(np.ptp(root)), 1e-9)
        if size > 0:
            precision = 1 / (noise / size + (remembered / width) ** 2)
            weight[0] += precision
            right[0] += precision * float((outward * moved).sum()) / size
        chi2 += float((moved**2).sum()) / noise
        count += moved.size
        rate = drift_between(record.time_s, record.air, root_of_time(record))
        grown = drift_between(record.time_s, record.air, record.total_N)
        if rate:
            share = rate * len(record.rest_mm) / record.markers
            frames = max(min(int(record.air.sum()) // 2, 15), 1)
            sd = np.hypot(
                record.force_sd_N * np.sqrt(2 * white * len(record.rest_mm) / frames),
                REMEMBERED * float(np.abs(record.total_N).max()),
            ) / float(np.ptp(record.time_s[record.air]))
            precision = (share / sd) ** 2
            weight[1] += precision
            right[1] += precision * grown / share
    if not weight[0]:
        return None
    spread = np.array([PRIOR_SD[STRAIN], PRIOR_SD[FORCE]])
    at = right / (weight + spread**-2.0)
    sd = (weight + spread**-2.0) ** -0.5
    if abs(at[0]) < SURE * sd[0]:
        return None
    evidence = (at**2 / sd**2 / 2 + np.log(sd / spread)).sum()
    return RelationFit(
        values=dict(zip((STRAIN, FORCE), at.tolist(), strict=True)),
        sd=dict(zip((STRAIN, FORCE), sd.tolist(), strict=True)),
        evidence=float(evidence),
        left=chi2 / max(count, 1),
    )


EFFECT: Effect = ThermalDrift(
    spec=SPEC,
    law=Warming(),
    amounts=(STRAIN, FORCE),
    prior_sd=PRIOR_SD,
)
