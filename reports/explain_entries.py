"""What the page of a mismatch is told: frozen records of one fruit's explanation, finished figures only.

Units are in the names; standard deviations are one sigma, intervals hold 90 %.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from jaxtyping import Float, Int

Value = float | tuple[float, ...] | str


@dataclass(frozen=True, kw_only=True)
class EffectEntry:
    """An effect in words: `short` completes "Most likely ..."; `meaning` and `advice` are whole sentences."""

    short: str
    meaning: str
    advice: str


@dataclass(frozen=True, kw_only=True)
class ParameterEntry:
    """One parameter of an effect; `words`: its meaning; `sd` None: not estimated; `interval` for scalars."""

    name: str
    value: Value
    sd: float | tuple[float, ...] | None
    unit: str
    interval: tuple[float, float] | None = None
    words: str = ""


@dataclass(frozen=True, kw_only=True)
class CandidateEntry:
    """One explanation: its probability among all tried, its evidence and what it does for held-out grasps."""

    effect: str
    probability: float
    log_evidence: float
    chi2_gain: float
    heldout_gain: float | None = None
    refitted: bool = False
    parameters: tuple[ParameterEntry, ...] = ()
    E_MPa: float | None = None
    E_sd_MPa: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class TraceEntry:
    """One grasp by the fit of the others: force over how far the flesh gave way, measured and modelled."""

    grasp: str
    time_s: Float[np.ndarray, " t"]
    phase: tuple[str, ...]
    force_N: Float[np.ndarray, " t"]
    given_mm: Float[np.ndarray, " t"]
    before_mm: Float[np.ndarray, " t"]
    after_mm: Float[np.ndarray, " t"]


@dataclass(frozen=True, kw_only=True)
class CellEntry:
    """The modulus that one frame of one pad gives by itself."""

    grasp: str
    pad: str
    time_s: float
    phase: str
    E_MPa: float
    E_sd_MPa: float


@dataclass(frozen=True, kw_only=True)
class VarianceEntry:
    """How much of the modulus's variation one factor explains, and the probability of so much by chance."""

    factor: str
    share: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class CheckEntry:
    """A number of the recordings, and what the model makes of it without and with the effect."""

    name: str
    measured: float
    before: float
    after: float
    sd: float
    unit: str


@dataclass(frozen=True, kw_only=True, eq=False)
class MapEntry:
    """Standard scores on the fruit's skin; `visible` below three is where nothing could be seen."""

    vertices_mm: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]
    modulus_score: Float[np.ndarray, " n"]
    eigenstrain_score: Float[np.ndarray, " n"]
    law_error: Float[np.ndarray, " n"]
    visible: Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplainEntry:
    """All that the page says of one fruit. `verdict`: the names left; one, or several not told apart.

    `rms`: normalised force residual on grasps the fit did not see: before, after, and of noise alone.
    """

    name: str
    category: str
    detected: bool
    p_value: float
    verdict: tuple[str, ...]
    region: str
    when: str
    component: str
    ranking: tuple[CandidateEntry, ...]
    E_before_MPa: float
    E_before_sd_MPa: float
    E_after_MPa: float
    E_after_sd_MPa: float
    made_utc: datetime
    effects: Mapping[str, EffectEntry] = field(default_factory=dict)
    """Words of the single effects in verdict and ranking, by name."""
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: float | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)
    rms: tuple[float, float, float] | None = None
    next_grasp: str | None = None
    cells: tuple[CellEntry, ...] = ()
    variance: tuple[VarianceEntry, ...] = ()
    traces: tuple[TraceEntry, ...] = ()
    checks: tuple[CheckEntry, ...] = ()
    map: MapEntry | None = None
    contacts_mm: Mapping[str, Float[np.ndarray, "p 3"]] = field(default_factory=dict)
    """Where each pad touched, all grasps together."""
    grasps: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    applied: str = ""
    """One sentence where the effect was written into a batch's settings, or why it was not."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    facts: tuple[tuple[str, str], ...] = ()
    """(label, value): Poisson's ratio, elements, versions."""
    inputs: tuple[tuple[str, str], ...] = ()
    """(file, SHA-256 in hex)."""
