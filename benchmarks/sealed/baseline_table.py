"""The finder beside the baselines on the same cases: naming, held-out fit, coverage of E."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from baseline_answers import BASELINES
from parameter_errors import NINETY
from sealed_scores import Scored, inside

CLASSES = 2
"""Truths among a bank's cases, at least, for a forest to be trained on them."""
FOLDS = 5
"""Parts of the sealed cases where no bank is at hand: a case is answered by a forest of the other parts."""
FINDER = "this finder"


def finder_answer(one: Scored) -> dict[str, Any]:
    """The finder's own answer, as the baselines give theirs."""
    weighed = one.row.get("weighed", {})
    ratio = weighed["after"] / weighed["before"] if weighed.get("before") else None
    E = one.row["E_after"]
    return {
        "verdict": list(one.verdict) if one.detected else ["none"],
        "order": list(one.order) if one.detected and not one.unknown else [],
        "E": [E["value"], E["sd"]],
        "interval": E["interval"],
        "heldout_ratio": ratio,
    }


def baseline_table(
    cases: Sequence[Scored], *, lost: int = 0, bank: Sequence[Mapping[str, Any]] = ()
) -> list[str]:
    """One row per method over all answered cases; `lost`: cases without the finder's answer, told apart."""
    answers: dict[str, list[dict[str, Any] | None]] = {FINDER: [finder_answer(one) for one in cases]}
    for name in BASELINES[:-1]:
        answers[name] = [one.row.get("baselines", {}).get(name) for one in cases]
    lines = ["", f"beside baselines ({len(cases)} cases{f', {lost} more without an answer' if lost else ''})"]
    forest = _forest_answers(cases, bank) if find_spec("sklearn") else None
    if forest is None:
        lines.append("  random forest: not trained (needs scikit-learn, and cases of two truths at least)")
    else:
        answers[BASELINES[-1]], said = forest
        lines.append(f"  random forest: {said}")
    lines.append(
        f"  {'':18s} {'false alarms':>14s} {'first name':>12s} {'both of pair':>13s} {'unknown':>9s} "
        f"{'held-out':>9s} {'E inside':>10s} {'E error':>8s}"
    )
    return lines + [row_of(name, cases, own) for name, own in answers.items()]


def _forest_answers(
    cases: Sequence[Scored], bank: Sequence[Mapping[str, Any]]
) -> tuple[list[dict[str, Any] | None], str] | None:
    """Its answers, and what it was trained on: a bank, or else the other parts of these very cases, which are
    drawn alike, so that it is judged kindly.
    """
    from random_forest import Forest

    features = [one.row.get("features") for one in cases]
    if len({row["truth"] for row in bank}) >= CLASSES:
        forest = Forest(bank)
        return [None if own is None else forest.answer(own) for own in features], (
            f"trained on {len(bank)} cases of a bank, {forest.accuracy():.0%} of them right by forests of "
            "other fruit"
        )
    rows = [
        {"truth": one.truth, "fruit": one.case, "features": own}
        for one, own in zip(cases, features, strict=True)
        if own is not None
    ]
    if len({row["truth"] for row in rows}) < CLASSES or len(rows) < FOLDS:
        return None
    found: dict[str, dict[str, Any]] = {}
    for part in range(FOLDS):
        forest = Forest([row for k, row in enumerate(rows) if k % FOLDS != part])
        found |= {row["fruit"]: forest.answer(row["features"]) for row in rows[part::FOLDS]}
    return [found.get(one.case) for one in cases], (
        f"trained on {FOLDS - 1} fifths of these cases, asked about the rest"
    )


def row_of(name: str, cases: Sequence[Scored], answers: Sequence[Mapping[str, Any] | None]) -> str:
    """One method: counts by kind; median over cases with an effect of the held-out residual's squares over
    those of the plain model; E inside its 90 % interval, median |error| of E.
    """
    both = [(one, own) for one, own in zip(cases, answers, strict=True) if own is not None]

    def counted(kind: str, right: Any) -> str:
        rows = [bool(right(one, own)) for one, own in both if one.kind == kind]
        return f"{sum(rows)} of {len(rows)}"

    ratios = [
        own["heldout_ratio"]
        for one, own in both
        if one.kind != "sound" and own["heldout_ratio"] is not None and np.isfinite(own["heldout_ratio"])
    ]
    known = [(one.label["E_MPa"], own) for one, own in both if own["E"] is not None]
    held = [inside(interval_of(own), E) for E, own in known]
    errors = [abs(own["E"][0] / E - 1) for E, own in known]
    cells = (
        counted("sound", lambda _, own: own["verdict"] != ["none"]),
        counted("single", lambda one, own: list(own["order"])[:1] == [one.truth]),
        counted("pair", lambda one, own: first_two(own["order"]) == set(one.truth.split("+"))),
        counted("outside", lambda _, own: own["verdict"] == ["unknown"]),
        f"{np.median(ratios):.2f}" if ratios else "-",
        f"{sum(held)} of {len(held)}" if held else "-",
        f"{np.median(errors):.1%}" if errors else "-",
    )
    return f"  {name:18s} " + " ".join(
        f"{cell:>{width}s}" for cell, width in zip(cells, (14, 12, 13, 9, 9, 10, 8), strict=True)
    )


def interval_of(own: Mapping[str, Any]) -> Sequence[float]:
    """An answer's 90 % interval of E: its own, or by its standard deviation."""
    if "interval" in own:
        return list(own["interval"])
    value, sd = own["E"]
    return [value - NINETY * sd, value + NINETY * sd]


def first_two(order: Sequence[str]) -> set[str]:
    """The first two effects of an order, in one explanation or in two."""
    if order and "+" in order[0]:
        return set(order[0].split("+"))
    return set(order[:2])
