"""`gel_hysteresis`: the force that a gel reads is too low during unloading.

    f_recorded = f (1 - 4 share r (1 - r)),      r = F / (largest F so far)

at each marker; F: the pad's normal force. The reading lacks the fraction `share` halfway down and nothing at
the peak and at the end. Force against displacement is a loop whose width grows with the peak. A second press
up to that peak follows it, as in filled rubbers (Mullins 1969, Rubber Chemistry and Technology 42; Johnson
1985, Contact Mechanics, chapter 9.4, for loops whose area is a share of the work). All markers of a pad show
the same loop. A fruit that yields shows none, since both force and displacement are the gel's own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.evidence.gel_relation import GelRecord
from fem.mismatch.gel_fault import GelFault

SHARE = "share"
LEAST_PEAK = 0.02
"""Share of the whole press's peak below which a peak so far counts as noise."""
NO_FORCE_N = 1e-12
"""Force that counts as zero."""
TURNS = 12
"""Newton iterations for r, the root of a cubic that increases everywhere for shares up to 3/4."""
PRIOR_SD = {SHARE: 0.08}
"""A share of the force: the third level of samples/mismatch/injected.py."""

SPEC = EffectSpec(
    name="gel_hysteresis",
    rank=220,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="the gel's force lags while the pad is let go",
        meaning="Force against the gel's own displacement runs lower on the way back than on the way in, "
        "alike all over the pad: the gel loses energy, not the fruit.",
        advice="Grade by the loading, and let the gel rest between grasps. Apply the effect: forces on the "
        "way back are corrected.",
    ),
    parameters=(
        EffectParameter(
            SHARE,
            "1",
            "share of the force that lacks halfway down",
            limits=(0.0, 0.5),
            low=0.0,
            high=0.2,
        ),
    ),
    correction=Correction.GEL_HYSTERESIS,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


@dataclass(frozen=True)
class Loop:
    """The law of the module."""

    def recorded(self, true: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """Force minus the lacking part."""
        r = _of_the_peak(true)
        return replace(true, force_N=true.force_N * (1 - 4 * values[SHARE] * r * (1 - r))[:, None, None])

    def undone(self, recorded: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """The force over its recorded fraction; r follows from the pad's recorded total."""
        share = values[SHARE]
        seen = _of_the_peak(recorded)
        r = seen
        for _ in range(TURNS):
            off = r * (1 - 4 * share * r * (1 - r)) - seen
            r = np.clip(r - off / (1 - 8 * share * r + 12 * share * r**2), 0.0, 1.0)
        return replace(recorded, force_N=recorded.force_N / (1 - 4 * share * r * (1 - r))[:, None, None])


def _of_the_peak(record: GelRecord) -> Float[np.ndarray, " t"]:
    """r of the module's docstring."""
    total = record.total_N
    peak = np.maximum.accumulate(np.maximum(total, max(LEAST_PEAK * float(total.max()), NO_FORCE_N)))
    return np.asarray(np.clip(total / peak, 0.0, 1.0))


EFFECT: Effect = GelFault(spec=SPEC, law=Loop(), amounts=(SHARE,), prior_sd=PRIOR_SD)
