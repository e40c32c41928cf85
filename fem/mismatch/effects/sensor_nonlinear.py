"""`sensor_nonlinear`: the force that a gel reads is not linear in the true force.

    f_recorded = f (1 + a |f| / M),      M: the largest |f| of any marker in the recording

at each marker, with the same a. A gel is linear in small deformation (Johnson 1985, Contact Mechanics,
chapter 4), so that a nonlinear reading bends recorded force against the gel's displacement. A gel that is
itself nonlinear, read correctly, does so too. Fits of the flesh with and without the law inverted separate
the two (fem.mismatch.gel_fault).

    |f| = M (sqrt(1 + 4 a r / M) - 1) / (2 a),      M = r_largest / (1 + a),      r = |f_recorded|
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.evidence.gel_relation import GelRecord
from fem.mismatch.gel_fault import GelFault

AMOUNT = "a"
LOWEST, HIGHEST = -0.45, 2.0
"""Bounds of a. Below -0.5 the reading decreases as the force grows; at 2.0 it is three times the force."""
PRIOR_SD = {AMOUNT: 0.3}
"""A share of the force: the third level of samples/mismatch/injected.py."""
NONE = 1e-9
"""Amount that counts as zero."""

SPEC = EffectSpec(
    name="sensor_nonlinear",
    rank=200,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="the force reading is not linear: large forces are read too low or too high",
        meaning="Force against the gel's own displacement bends with the load, alike in all markers, and the "
        "fruit is understood better with that bend taken out of the forces.",
        advice="Calibrate the pads at several loads up to the largest in use. Until then apply the effect: "
        "forces of the whole batch are corrected.",
    ),
    parameters=(
        EffectParameter(
            AMOUNT,
            "1",
            "how much the reading at the largest force exceeds that force, as a share",
            limits=(-0.49, 10.0),
            low=LOWEST,
            high=HIGHEST,
        ),
    ),
    correction=Correction.FORCE_LAW,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


@dataclass(frozen=True)
class BentReading:
    """The law of the module."""

    def recorded(self, true: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """Force times 1 + a |f| / M."""
        size = np.linalg.norm(true.force_N, axis=2, keepdims=True)
        share = values[AMOUNT] * (1 + values[AMOUNT]) / true.largest_N
        return replace(true, force_N=true.force_N * (1 + share * size))

    def undone(self, recorded: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """The positive root; a force that noise lifts beyond the law's greatest is clipped to it."""
        a = values[AMOUNT]
        if abs(a) < NONE:
            return recorded
        size = np.linalg.norm(recorded.force_N, axis=2, keepdims=True)
        share = a * (1 + a) / recorded.largest_N
        root = np.sqrt(np.maximum(1 + 4 * share * size, (1 + 2 * LOWEST) ** 2))
        return replace(recorded, force_N=recorded.force_N * 2 / (1 + root))


EFFECT: Effect = GelFault(spec=SPEC, law=BentReading(), amounts=(AMOUNT,), prior_sd=PRIOR_SD)
