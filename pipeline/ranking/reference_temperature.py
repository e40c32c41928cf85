"""E at a reference temperature, by the user's own coefficient.

Flesh softens as it warms. With d ln E / dT = c ± s per °C, E at the temperature R of a fruit grasped at T is
E exp(c (R - T)). The coefficient's error adds s |R - T| to the standard deviation of ln E. All fruit of a
batch share that error, so that it does not affect their order.
"""

import math
from collections.abc import Sequence

from pipeline.batch.records import FruitRecord, TemperatureRecord
from pipeline.batch.settings import Settings
from pipeline.ranking.reference_ratio import ReferenceFinding, against_references, scaled_grasp

PART = "temperature coefficient"
"""The part of an error bar that comes from it."""


def compared(
    records: Sequence[FruitRecord], settings: Settings
) -> tuple[list[FruitRecord], ReferenceFinding | None]:
    """The records as reports show them: against the reference bodies, then at the reference temperature."""
    in_order, finding = against_references(records, correct=settings.reference.correct)
    return [at_reference_temperature(record, settings) for record in in_order], finding


def at_reference_temperature(record: FruitRecord, settings: Settings) -> FruitRecord:
    """The fruit with E at the reference temperature; unchanged without a coefficient, or if a reference
    body."""
    wanted, pulp_C, modulus = settings.temperature, settings.pulp_temperature_C, record.modulus
    if wanted is None or pulp_C is None or record.given.reference or not record.graded or modulus is None:
        return record.model_copy(update={"temperature": None})
    warmer_C = wanted.reference_C - pulp_C
    factor = math.exp(wanted.E_per_C * warmer_C)
    of_coefficient = factor * modulus.E_MPa * wanted.E_per_C_sd * abs(warmer_C)
    changed = modulus.scaled(factor).widened(PART, of_coefficient, shared=True)
    temperature = TemperatureRecord(
        pulp_C=pulp_C,
        reference_C=wanted.reference_C,
        factor=factor,
        E_at_pulp_MPa=modulus.E_MPa,
        E_at_pulp_sd_MPa=modulus.E_sd_MPa,
        E_MPa=changed.E_MPa,
        E_sd_MPa=changed.E_sd_MPa,
    )
    grasps = tuple(scaled_grasp(grasp, 1 / factor) for grasp in record.grasps)
    return record.model_copy(update={"modulus": changed, "grasps": grasps, "temperature": temperature})
