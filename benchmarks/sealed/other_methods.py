"""The finder beside the other methods whose answers the blind rows hold: false alarms, naming, E."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sealed_scores import NINETY, Scored, inside

METHODS = ("modulus alone", "Gaussian process", "sparse regression", "random forest")
FINDER = "this finder"


def finder_answer(case: Scored) -> dict[str, Any]:
    """The finder's answer, as the rows hold those of other methods."""
    E = case.row["E_after"]
    return {
        "verdict": list(case.verdict) if case.detected else ["none"],
        "order": list(case.order) if case.detected and not case.unknown else [],
        "E": [E["value"], E["sd"]],
    }


def method_table(cases: Sequence[Scored], *, lost: int = 0) -> list[str]:
    """One row per method over all answered cases; `lost`: cases without the finder's answer, told apart."""
    answers = {FINDER: [finder_answer(case) for case in cases]} | {
        name: [case.row.get("baselines", {}).get(name) for case in cases] for name in METHODS
    }
    lines = ["", f"beside baselines ({len(cases)} cases{f', {lost} more without an answer' if lost else ''})"]
    lines.append(
        f"  {'':18s} {'false alarms':>14s} {'first name':>12s} {'both of pair':>13s} {'unknown':>9s} "
        f"{'E inside':>10s} {'E error':>8s}"
    )
    return lines + [
        row_of(name, cases, case_answers) for name, case_answers in answers.items() if any(case_answers)
    ]


def row_of(name: str, cases: Sequence[Scored], answers: Sequence[Mapping[str, Any] | None]) -> str:
    """One method: counts by kind; E inside its 90 % interval; median |error| of E."""
    both = [(case, answer) for case, answer in zip(cases, answers, strict=True) if answer is not None]

    def counted(kind: str, right: Any) -> str:
        rows = [bool(right(case, answer)) for case, answer in both if case.kind == kind]
        return f"{sum(rows)} of {len(rows)}"

    E = np.array([[case.label["E_MPa"], *answer["E"]] for case, answer in both])
    held = [inside((value - NINETY * sd, value + NINETY * sd), truth) for truth, value, sd in E]
    cells = (
        counted("sound", lambda _, answer: answer["verdict"] != ["none"]),
        counted("single", lambda case, answer: list(answer["order"])[:1] == [case.truth]),
        counted("pair", lambda case, answer: first_two(answer["order"]) == set(case.truth.split("+"))),
        counted("outside", lambda _, answer: answer["verdict"] == ["unknown"]),
        f"{sum(held)} of {len(held)}",
        f"{np.median(np.abs(E[:, 1] / E[:, 0] - 1)):.1%}",
    )
    return f"  {name:18s} " + " ".join(
        f"{cell:>{width}s}" for cell, width in zip(cells, (14, 12, 13, 9, 10, 8), strict=True)
    )


def first_two(order: Sequence[str]) -> set[str]:
    """The first two effects of an order, in one explanation or in two."""
    if order and "+" in order[0]:
        return set(order[0].split("+"))
    return set(order[:2])
