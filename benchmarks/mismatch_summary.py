"""Many scored cases: the table, and what it comes to."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from fem.mismatch.result import NONE, UNKNOWN

SIGNALS = (0.0, 1.0, 3.0, 10.0, np.inf)
"""Bins of signal over noise: what the plain model leaves of recordings held out, beyond their noise."""


def table(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row per case, plain columns; parameters as words."""
    flat = []
    for row in rows:
        own = {name: value for name, value in row.items() if not isinstance(value, list | dict)}
        own["verdict"] = " | ".join(row.get("verdict", []))
        own["parameters"] = "; ".join(map(_said, row.get("parameters", [])))
        flat.append(own)
    first = ["ablation", "folder", "case", "truth", "verdict", "parameters", "failure"]
    frame = pd.DataFrame(flat)
    known = [name for name in first if name in frame]
    return frame[[*known, *(name for name in frame if name not in known)]]


def _said(one: dict[str, Any]) -> str:
    if "error" not in one:
        return f"{one['name']} {one['value']} ({one['truth']})"
    inside = f"{sum(one['inside'])}/{len(one['inside'])} inside"
    return f"{one['name']} {_short(one['value'])} ({_short(one['truth'])}) {one['error']:+.1%} {inside}"


def _short(value: Any) -> str:
    return " ".join(f"{x:.4g}" for x in np.atleast_1d(np.array(value, dtype=float)))


def summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Lines: confusion, false alarms, detection by amplitude, naming, parameters, moduli, proof, cost."""
    scored = [row for row in rows if "failure" not in row]
    lines = [f"{len(scored)} cases, {len(rows) - len(scored)} without an answer"]
    if not scored:
        return lines
    versions = {row["code"] for row in scored}
    if len(versions) > 1:
        lines.append(f"made by {len(versions)} states of the code: run with --again for one")
    lines += ["", "truth: verdicts", *_confusion(scored)]
    nulls = [row for row in scored if row["truth"] == NONE]
    single = [row for row in scored if row["truth"] not in (NONE, UNKNOWN) and "+" not in row["truth"]]
    pairs = [row for row in scored if "+" in row["truth"]]
    outside = [row for row in scored if row["truth"] == UNKNOWN]
    lines += ["", _share("false alarms", nulls, lambda row: row["detected"])]
    lines += _by_signal([*single, *pairs])
    for title, group in (("single effects", single), ("two at once", pairs)):
        if not group:
            continue
        lines += [
            "",
            title,
            _share("  detected", group, lambda row: row["detected"]),
            _share("  right name first", group, lambda row: row["right_first"]),
            _share("  in the first two", group, lambda row: row["right_in_two"]),
            _share("  verdict holds it", group, lambda row: row["in_set"]),
            f"  mean size of a verdict {np.mean([row['set_size'] for row in group]):.2f}",
            _share("  family right", group, lambda row: row["family_right"]),
        ]
    if pairs:
        lines.append(_share("  one of the two named", pairs, lambda row: row["one_of_two"]))
    lines += [_share("called unknown, rightly", outside, lambda row: row["right_first"]), ""]
    return [*lines, *_parameters(scored), *_moduli(scored), *_proof([*single, *pairs]), *_cost(scored)]


def _confusion(rows: Sequence[dict[str, Any]]) -> list[str]:
    by_truth: dict[str, Counter[str]] = {}
    for row in rows:
        by_truth.setdefault(row["truth"], Counter())[" | ".join(row["verdict"])] += 1
    return [
        f"  {truth:28s} " + "  ".join(f"{n} x [{said}]" for said, n in counted.most_common())
        for truth, counted in sorted(by_truth.items())
    ]


def _share(title: str, rows: Sequence[dict[str, Any]], true: Any) -> str:
    count = sum(bool(true(row)) for row in rows)
    return f"{title} {count} of {len(rows)}" + (f" = {count / len(rows):.1%}" if rows else "")


def _by_signal(rows: Sequence[dict[str, Any]]) -> list[str]:
    signal = np.array([signal_over_noise(row) for row in rows])
    lines = []
    for low, high in pairwise(SIGNALS):
        own = [row for row, size in zip(rows, signal, strict=True) if low <= size < high]
        if own:
            lines.append(
                _share(f"detected, signal/noise {low:g} to {high:g}:", own, lambda row: row["detected"])
            )
    return lines


def signal_over_noise(row: dict[str, Any]) -> float:
    """NaN where there was nothing to hold out."""
    before, noise = row["heldout_before"], row["heldout_noise"]
    if before is None or not noise:
        return float("nan")
    return float(np.sqrt(max(before**2 - noise**2, 0.0)) / noise)


def _parameters(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Median of |relative error| and coverage, parameter by parameter and over all."""
    by_name: dict[str, list[dict[str, Any]]] = {}
    words = [one for row in rows for one in row["parameters"] if "error" not in one]
    for row in rows:
        for one in row["parameters"]:
            if "error" in one:
                by_name.setdefault(one["name"], []).append(one)
    lines = ["parameter: median |error|, truth inside its 90 % interval"] if by_name else []
    everything = [one for found in by_name.values() for one in found]
    for name, own in [*sorted(by_name.items()), *([("all", everything)] if everything else [])]:
        inside = [x for one in own for x in one["inside"]]
        lines.append(
            f"  {name:34s} {np.median([abs(one['error']) for one in own]):7.1%} "
            f"{sum(inside):3d} of {len(inside)}"
        )
    if words:
        lines.append(_share("  pad right", words, lambda one: one["value"] == one["truth"]))
    centres = [row["centre_off_mm"] for row in rows if row["centre_off_mm"] is not None]
    if centres:
        lines.append(f"  soft spot's centre off by {np.median(centres):.2f} mm (median of {len(centres)})")
    return lines


def _moduli(rows: Sequence[dict[str, Any]]) -> list[str]:
    lines = []
    for when in ("before", "after"):
        error = np.abs([row[f"E_{when}_error"] for row in rows])
        inside = [row[f"E_{when}_inside"] for row in rows]
        lines.append(
            f"E {when}: median |error| {np.median(error):.2%}, largest {error.max():.1%}, "
            f"inside its 90 % interval {sum(inside)} of {len(inside)}"
        )
    return lines


def _proof(rows: Sequence[dict[str, Any]]) -> list[str]:
    cut = []
    for row in rows:
        if row["detected"] and row["heldout_before"] is not None:
            beyond = [
                max(row[f"heldout_{when}"] ** 2 - row["heldout_noise"] ** 2, 1e-12)
                for when in ("before", "after")
            ]
            cut.append(np.sqrt(beyond[0] / beyond[1]))
    return [f"held-out excess cut {np.median(cut):.1f} times (median of {len(cut)})"] if cut else []


def _cost(rows: Sequence[dict[str, Any]]) -> list[str]:
    seconds, busy = ([row[name] for row in rows] for name in ("seconds", "cpu_s"))
    memory = [row["peak_MiB"] for row in rows]
    return [
        f"a case: {np.median(seconds):.0f} s (most {max(seconds):.0f}), {np.median(busy):.0f} s of CPU "
        f"(most {max(busy):.0f}), peak memory {np.median(memory):.0f} MiB (most {max(memory):.0f})"
    ]
