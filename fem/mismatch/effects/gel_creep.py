"""`gel_creep`: the gel's face creeps under load, and its markers move with it.

    d_recorded = d + creep m,      m' = (d - m) / creep_tau_s,      m = 0 at first

at each marker; the force is correct. Between frames the displacement is constant at its new value, so that

    m_k = q m_(k-1) + (1 - q) d_k,      q = exp(-(t_k - t_(k-1)) / creep_tau_s)

(one arm of a generalised Kelvin solid: Findley, Lai and Onaran 1976, Creep and Relaxation, chapter 5). The
displacement lags the force at every marker and persists for a while after unloading. The markers' places on
the fruit are off by the creep, so that the flesh appears to recover under load.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.evidence.gel_relation import GelRecord
from fem.mismatch.gel_fault import GelFault

CREEP, TAU = "creep", "creep_tau_s"
PRIOR_SD, BEGUN = {CREEP: 0.3, TAU: 3.0}, {TAU: 1.0}
"""Priors (a ratio, s): the third level of samples/mismatch/injected.py. The fit starts at about the time of a
press."""

SPEC = EffectSpec(
    name="gel_creep",
    rank=210,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="the gel of the pads creeps under load",
        meaning="Markers go on moving under a steady force and come back late after it, alike all over the "
        "pad: the gel gives way, not the fruit.",
        advice="Press more slowly or hold shorter, and let the gel rest between grasps. Apply the effect: "
        "markers are put back by what the gel has crept.",
    ),
    parameters=(
        EffectParameter(
            CREEP,
            "1",
            "creep over displacement at once, after a long hold",
            limits=(0.0, 10.0),
            low=0.0,
            high=2.0,
        ),
        EffectParameter(
            TAU,
            "s",
            "time over which it creeps",
            limits=(1e-3, 1e4),
            low=0.1,
            high=60.0,
            log=True,
        ),
    ),
    correction=Correction.GEL_CREEP,
    knows_time=True,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


@dataclass(frozen=True)
class CreepingFace:
    """The law of the module."""

    def recorded(self, true: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """Displacement plus creep."""
        moved = true.displacement_mm
        crept = values[CREEP] * memory(moved, true.time_s, values[TAU])
        return replace(true, displacement_mm=moved + crept)

    def undone(self, recorded: GelRecord, values: Mapping[str, float]) -> GelRecord:
        """The displacement minus creep, frame by frame."""
        creep, time_s = values[CREEP], recorded.time_s
        moved = recorded.displacement_mm.copy()
        before = np.zeros_like(moved[0])
        for k in range(len(time_s)):
            fade = 0.0 if k == 0 else float(np.exp(-(time_s[k] - time_s[k - 1]) / values[TAU]))
            fresh = 0.0 if k == 0 else 1 - fade
            moved[k] = (moved[k] - creep * fade * before) / (1 + creep * fresh)
            before = fade * before + fresh * moved[k]
        return replace(recorded, displacement_mm=moved)


def memory(
    values: Float[np.ndarray, "t n 3"], time_s: Float[np.ndarray, " t"], tau_s: float
) -> Float[np.ndarray, "t n 3"]:
    """m of the module's docstring."""
    remembered = np.zeros_like(values)
    for k in range(1, len(time_s)):
        fade = float(np.exp(-(time_s[k] - time_s[k - 1]) / tau_s))
        remembered[k] = fade * remembered[k - 1] + (1 - fade) * values[k]
    return remembered


EFFECT: Effect = GelFault(
    spec=SPEC,
    law=CreepingFace(),
    amounts=(CREEP,),
    prior_sd=PRIOR_SD,
    others=BEGUN,
)
