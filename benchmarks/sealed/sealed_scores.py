"""Answers against revealed labels: what is counted of each case, and shares with their binomial intervals.

Signal over noise of a case is the root of the plain model's excess chi-square, sqrt(chi2 - usual), both of
the answer: what the plain model leaves, less what it usually leaves of sound recordings. Correlated numbers
count as one there (DESIGN_EFFECT), so that 10 is ten standard deviations of what is really independent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import NONE, UNKNOWN

NINETY_FIVE = 0.95
"""Of the binomial intervals (Clopper and Pearson 1934)."""
NINETY = 1.645
"""Standard deviations that hold 90 % of a normal distribution on either side."""
PLACES = ("centre_mm",)
"""Parameters whose size is where they count from: not scored by relative error."""
IN_CATALOGUE = {"palm": "third_contact", "gel_softening": "gel_softening"}
"""Physics outside the catalogue, by the name that it would have inside; others keep their own."""
RELATIVES = {
    "drainage": ("viscoelastic",),
    "palm": ("pose_error",),
    "gel_softening": ("gel_creep", "viscoelastic"),
    "split_pit": ("loose_pit",),
}
"""Relatives of physics outside the catalogue: the same cause but for its law, or its place."""


@dataclass(frozen=True, kw_only=True)
class Scored:
    """One case: its kind and true effect (joined by +), amplitudes, signal over noise, and what was said.

    `relatives`: answers that count as relatives of physics outside the catalogue.
    """

    case: str
    kind: str
    truth: str
    physics: str
    amplitudes: dict[str, float]
    signal: float
    detected: bool
    verdict: tuple[str, ...]
    order: tuple[str, ...]
    p: float
    row: dict[str, Any]
    label: dict[str, Any]
    relatives: tuple[str, ...] = ()

    @property
    def named_first(self) -> bool:
        """Whether the true effect is the first name of a case in which something was found."""
        return self.detected and not self.unknown and self.order[:1] == (self.truth,)

    @property
    def covered(self) -> bool:
        """Whether the verdict, one explanation or several that cannot be told apart, holds the truth."""
        return self.truth in self.verdict

    @property
    def both_named(self) -> bool:
        """Whether both effects of a pair are in the first explanation."""
        first = set(self.order[0].split("+")) if self.order else set()
        return self.detected and not self.unknown and first == set(self.truth.split("+"))

    @property
    def unknown(self) -> bool:
        """Whether it is called unknown."""
        return self.verdict == (UNKNOWN,)

    @property
    def related(self) -> bool:
        """Whether the verdict holds relatives of physics outside the catalogue, and nothing else."""
        said = {part for name in self.verdict for part in name.split("+")}
        return bool(said) and said <= set(self.relatives)


def scored(row: Mapping[str, Any], label: Mapping[str, Any]) -> Scored:
    """A row that holds an answer, with its label; a physics outside that the catalogue of the answer has
    counts as a single effect.
    """
    truth = label["attempts"][int(row["attempt"])]
    kind, name, physics = str(label["kind"]), str(truth["effect"]), ""
    if kind == "outside":
        physics = str(truth["parameters"].get("physics", ""))
        inside = IN_CATALOGUE.get(physics, physics)
        if inside in row.get("catalogue", ()):
            kind, name = "single", inside
    return Scored(
        case=str(row["case"]),
        kind=kind,
        truth=name,
        physics=physics,
        amplitudes=dict(truth["amplitudes"]),
        signal=signal_over_noise(row),
        detected=bool(row["detected"]),
        verdict=tuple(row["verdict"]),
        order=tuple(hypothesis["effect"] for hypothesis in row["ranking"] if hypothesis["effect"] != NONE),
        p=float(row["p"]),
        row=dict(row),
        label=truth,
        relatives=tuple(label.get("relatives", RELATIVES.get(physics, ()))),
    )


def signal_over_noise(row: Mapping[str, Any]) -> float:
    """Of a case, by its answer; NaN where the linear problem was not kept."""
    if "chi2" not in row:
        return float("nan")
    return float(np.sqrt(max(row["chi2"] - row["chi2_usual"], 0.0)))


def interval(count: int, total: int) -> tuple[float, float]:
    """Exact interval of a share (Clopper and Pearson)."""
    shares = binomtest(count, total).proportion_ci(NINETY_FIVE, method="exact")
    return float(shares.low), float(shares.high)


def share(title: str, truths: Sequence[bool]) -> str:
    """A line: how many, the share, its interval.

    >>> share("named", [True, False])
    'named: 1 of 2 = 50% (1% to 99%)'
    """
    count, total = sum(map(bool, truths)), len(truths)
    if not total:
        return f"{title}: no case"
    low, high = interval(count, total)
    return f"{title}: {count} of {total} = {count / total:.0%} ({low:.0%} to {high:.0%})"


def inside(interval_of: Sequence[float] | None, truth: float) -> bool:
    """Whether an interval holds the truth."""
    return interval_of is not None and bool(interval_of[0] <= truth <= interval_of[1])


def parameter_rows(case: Scored) -> list[tuple[str, float, bool | None]]:
    """Parameters of the true effect wherever it was refitted: name, relative error, inside the interval.

    Whatever the verdict. Words and places have no relative error and no row. Of several effects names begin
    with the effect's own and a point.
    """
    refitted = next((c for c in case.row["ranking"] if c["effect"] == case.truth and c["refitted"]), None)
    if refitted is None or case.truth in (NONE, UNKNOWN):
        return []
    effects, rows = case.truth.split("+"), []
    for effect in effects:
        true = true_parameters(case, effect)
        for spec in SPECS[effect].parameters if effect in SPECS else ():
            key = f"{effect}.{spec.name}" if len(effects) > 1 else spec.name
            scorable = spec.name not in PLACES and not isinstance(true.get(spec.name), str)
            if scorable and spec.name in true and key in refitted["parameters"]:
                rows.append(
                    (f"{effect}.{spec.name}", *_compared(refitted["parameters"][key], true[spec.name]))
                )
    return rows


def _compared(said: Mapping[str, Any], truth: Any) -> tuple[float, bool | None]:
    """The error's length over the truth's, and whether all components are inside; None without interval."""
    value, wanted = (np.atleast_1d(np.array(x, dtype=float)) for x in (said["value"], truth))
    size = max(float(np.linalg.norm(wanted)), np.finfo(float).tiny)
    error = float(np.linalg.norm(value - wanted)) / size
    if said["interval"] is not None:
        return error, inside(said["interval"], wanted[0])
    if said["sd"] is not None:
        spread = NINETY * np.atleast_1d(np.array(said["sd"], dtype=float))
        return error, bool((np.abs(value - wanted) <= spread).all())
    return error, None


def true_parameters(case: Scored, effect: str) -> dict[str, Any]:
    """An effect's parameters as formats define them: drifts in newtons, by the simulation's peak force."""
    parameters = case.label["parameters"]
    true = dict(parameters if "+" not in case.truth else parameters[effect])
    peak = max(case.row.get("peaks_N", [float("nan")]))
    if effect == "sensor_drift" and "share_per_s" in true:
        true["newton_per_s"] = true.pop("share_per_s") * peak
    if effect == "thermal_drift" and "peak_share_per_root_s" in true:
        true["N_per_root_s"] = true.pop("peak_share_per_root_s") * peak
    return true
