"""The explanation of one fruit for JSON (format drupe-mismatch, docs/formats.md), page and terminal.

This package imports nothing from fem: it reads attributes of the records in fem/mismatch/result.py
(candidates, moduli, checks, maps). Units are in the names; standard deviations are one sigma, intervals hold
90 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import datetime
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Float

FORMAT: Final = "drupe-mismatch"
VERSION: Final = 1
"""Name and number of the format in docs/formats.md; the number grows when an old reader would fail."""
OPTIONAL = frozenset({"E_withheld", "doubts", "p_nominal", "left_out"})
"""Keys that the JSON omits if they are empty."""
Record: TypeAlias = Any
"""A record of fem/mismatch/result.py."""


@dataclass(frozen=True, kw_only=True)
class EffectEntry:
    """An effect in words: `short` completes "Most likely ..."; `meaning` and `advice` are whole sentences."""

    short: str
    meaning: str
    advice: str


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplainEntry:
    """All that drupe writes about one fruit. `verdict`: one name, or several that cannot be distinguished.

    `before`, `after`: E without and with the effect; `withheld`: why no E is given (E is then NaN).
    `p_nominal`: what an uncalibrated p assumes. `left_out`: recordings that do not fit the others. `heldout`:
    residuals on held-out recordings, None without any. `doubts`: why E cannot be right. `applied`: a sentence
    on whether drupe wrote the effect into the batch's settings. `inputs`: SHA-256 in hex by file.

    The JSON omits `scale_sd` and the fields from `cells` on. `scale_sd`: standard deviation of ln E from the
    sensors' scales, which no E here includes. `effects`: words of the single effects; `parameter_words`:
    meanings by effect and parameter. `contacts_mm`: where each pad touched, all grasps together. `facts`:
    (label, value) of Poisson's ratio and elements.
    """

    detected: bool
    p_value: float
    where: Record
    when: str
    component: str
    ranking: tuple[Record, ...]
    verdict: tuple[str, ...]
    before: Record
    after: Record
    withheld: str | None = None
    doubts: tuple[str, ...] = ()
    scale_sd: float = 0.0
    heldout: Record | None = None
    next_grasp: str | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)
    p_nominal: str | None = None
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    case: str
    category: str
    grasps: tuple[str, ...] = ()
    applied: str | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    made_utc: datetime
    cells: tuple[Record, ...] = ()
    traces: tuple[Record, ...] = ()
    maps: Record | None = None
    effects: Mapping[str, EffectEntry] = field(default_factory=dict)
    parameter_words: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] = field(default_factory=dict)
    facts: tuple[tuple[str, str], ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Content of a drupe-mismatch file: null for non-finite numbers, without empty OPTIONAL keys."""
        written = {
            "format": FORMAT,
            "version": VERSION,
            **{name: getattr(self, name) for name in ("detected", "p_value", "where", "when", "component")},
            "ranking": [_candidate(candidate) for candidate in self.ranking],
            "verdict": self.verdict[0] if len(self.verdict) == 1 else self.verdict,
            "E_MPa": {"before": self.before, "after": self.after},
            "E_withheld": self.withheld,
            "doubts": self.doubts,
            "fit": {
                "heldout_rms_before": self.heldout and self.heldout.rms_before,
                "heldout_rms_after": self.heldout and self.heldout.rms_after,
                "noise_rms": self.heldout and self.heldout.noise_rms,
            },
            **{name: getattr(self, name) for name in ("next_grasp", "statistics", "p_nominal", "left_out")},
            **{name: getattr(self, name) for name in ("notes", "seconds", "case")},
            **{name: getattr(self, name) for name in ("category", "grasps", "applied", "inputs", "versions")},
            "made_utc": self.made_utc.isoformat(timespec="seconds"),
        }
        return {name: _plain(known) for name, known in written.items() if known or name not in OPTIONAL}


def _candidate(candidate: Record) -> dict[str, Any]:
    """One explanation: probability among all candidates, evidence, and gain on held-out grasps."""
    parameters = {name: _plain(parameter) for name, parameter in candidate.parameters.items()}
    for parameter in parameters.values():
        interval = parameter.pop("interval")
        if interval is not None:
            parameter["interval_90"] = interval
    return {
        "effect": candidate.effect,
        "probability": candidate.probability,
        "parameters": parameters,
        "log_evidence": candidate.log_evidence,
        "chi2_gain": candidate.gain,
        "heldout_gain": candidate.heldout and candidate.heldout[0],
        "heldout_gain_sd": candidate.heldout and candidate.heldout[1],
        "refitted": candidate.refitted,
        "E_MPa": candidate.modulus,
    }


def _plain(content: Any) -> Any:
    """Records as mappings, arrays and tuples as lists, numpy's numbers as Python's, None if not finite."""
    if is_dataclass(content):
        return {known.name: _plain(getattr(content, known.name)) for known in fields(content)}
    if isinstance(content, np.generic | np.ndarray):
        return _plain(content.tolist())
    if isinstance(content, Mapping):
        return {key: _plain(inner) for key, inner in content.items()}
    if isinstance(content, Sequence) and not isinstance(content, str):
        return [_plain(inner) for inner in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
