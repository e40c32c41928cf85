"""What the sealed proof comes to, as lines of text."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from psychometric import fitted_curve
from scipy.stats import kstest
from sealed_scores import NINETY, Scored, inside, parameter_rows, scored, share, signal_over_noise

PLAIN_SIGNAL = 10.0
"""Signal over noise from which an effect is plain."""
PROBABILITIES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Bins of the reliability diagram, for probabilities of names."""
KINDS = ("all", "sound", "single", "pair", "outside")
TENTHS = 10
"""Bins of the p-values of sound cases."""


def report(rows: Sequence[Mapping[str, Any]], labels: Mapping[str, Any]) -> list[str]:
    """Every table."""
    cases = [scored(row, labels[row["case"]]) for row in rows if "failure" not in row]
    lost = [row for row in rows if "failure" in row and not row.get("unsimulated")]
    return [
        f"{len(cases)} answers, {len(lost)} cases without one, "
        f"{sum(bool(row.get('unsimulated')) for row in rows)} not simulated, of {len(labels)}",
        *(f"  {row['case']}: {row['failure']}" for row in lost),
        "states of the code: " + ", ".join(sorted({str(row["code"]) for row in rows if "code" in row})),
        *tables(cases),
        *(method_table(cases, lost=len(lost)) if cases else []),
        "",
    ]


def tables(cases: Sequence[Scored]) -> list[str]:
    """Counts, confusion, reliability, coverage and curves of answered cases."""
    sound, singles, pairs, outside = ([case for case in cases if case.kind == kind] for kind in KINDS[1:])
    plain = [single for single in singles if single.signal > PLAIN_SIGNAL]
    covered = [case.covered for case in (*singles, *pairs) if case.detected]
    wrong = [case.detected and not case.unknown and not case.related for case in outside]
    return [
        share("false alarms in sound cases", [case.detected for case in sound]),
        *(
            share(f"  {law} flesh", [case.detected for case in sound if case.label.get("law") == law])
            for law in sorted({case.label["law"] for case in sound if "law" in case.label})
        ),
        share("single effects detected", [single.detected for single in singles]),
        share(f"  named first, signal/noise over {PLAIN_SIGNAL:g}", [case.named_first for case in plain]),
        share("  named first, all", [single.named_first for single in singles]),
        share("pairs with both named", [pair.both_named for pair in pairs]),
        share("  one of the two in the verdict", [_one_of_two(pair) for pair in pairs]),
        share("verdict covers the truth, where something was found", covered),
        share("outside the catalogue: called unknown", [case.unknown for case in outside]),
        share("  unknown or a relative", [case.unknown or case.related for case in outside]),
        share("  taken for another effect", wrong),
        "",
        *confusion(cases),
        "",
        *reliability(cases),
        "",
        *coverage(cases),
        "",
        *curves(singles),
    ]  # fmt: skip


def _one_of_two(case: Scored) -> bool:
    said = {part for name in case.verdict for part in name.split("+")}
    return bool(said & set(case.truth.split("+")))


def confusion(cases: Sequence[Scored]) -> list[str]:
    """Truth to verdicts, commonest first; the matrix's zeros left out."""
    by_truth: dict[str, Counter[str]] = {}
    for case in cases:
        truth = f"{case.truth} ({case.physics})" if case.physics else case.truth
        by_truth.setdefault(truth, Counter())[" | ".join(case.verdict)] += 1
    return ["truth: verdicts"] + [
        f"  {truth:34s} " + "  ".join(f"{count} x [{said}]" for said, count in verdicts.most_common())
        for truth, verdicts in sorted(by_truth.items())
    ]


def name_probabilities(cases: Sequence[Scored]) -> list[tuple[float, bool]]:
    """Of each case in which something was found: the first name's probability, and whether it is true."""
    probabilities = []
    for case in cases:
        first = next((c for c in case.row["ranking"] if c["effect"] != "none"), None)
        if case.detected and first is not None:
            probabilities.append((float(first["probability"]), first["effect"] == case.truth))
    return probabilities


def reliability(cases: Sequence[Scored]) -> list[str]:
    """p of sound cases by tenths and against the uniform; probabilities of first names against truth."""
    p = np.array([case.p for case in cases if case.kind == "sound"])
    counts = np.histogram(p, TENTHS, (0.0, 1.0))[0]
    lines = [f"p of {len(p)} sound cases by tenths: {' '.join(map(str, counts))}"]
    if len(p) > 1:
        lines.append(f"  Kolmogorov and Smirnov against the uniform: {kstest(p, 'uniform').pvalue:.2g}")
    lines.append("probability of the first name: mean said, share true, cases")
    for (low, high), (mean, true, _, count) in reliability_bins(cases, PROBABILITIES).items():
        lines.append(f"  {low:.2f} to {high:.2f}: {mean:.2f}, {true:.2f}, {count}")
    return lines


def reliability_bins(
    cases: Sequence[Scored], edges: Sequence[float]
) -> dict[tuple[float, float], tuple[float, float, int, int]]:
    """Of each bin that is not empty: mean stated probability, share right, how many right, of how many."""
    stated = name_probabilities(cases)
    bins = {}
    for low, high in pairwise(edges):
        group = [(p, right) for p, right in stated if low <= p < high or p == high == 1.0]
        if group:
            count = sum(right for _, right in group)
            bins[low, high] = (float(np.mean([p for p, _ in group])), count / len(group), count, len(group))
    return bins


def coverage(cases: Sequence[Scored]) -> list[str]:
    """90 % intervals of parameters, and of E before and after by kind of case, whatever the verdict."""
    rows = [row for case in cases for row in parameter_rows(case)]
    held = [bool(ok) for _, _, ok in rows if ok is not None]
    lines = [share("parameters inside their 90 % intervals", held)]
    if rows:
        lines.append(f"  median |relative error| {np.median([error for _, error, _ in rows]):.1%}")
    for name, checks in pd.DataFrame(rows, columns=["name", "error", "ok"]).groupby("name"):
        known = checks["ok"].dropna()
        lines.append(f"  {name:34s} {checks['error'].median():7.1%}  inside {sum(known)} of {len(known)}")
    groups = {kind: [case for case in cases if kind in ("all", case.kind)] for kind in KINDS}
    for category in sorted({str(case.label.get("category")) for case in cases}):
        groups[f"sound {category}"] = [
            case for case in groups["sound"] if str(case.label.get("category")) == category
        ]
    for when, words in (("E_before", "E without an effect"), ("E_after", "E in the end")):
        lines += [modulus_line(f"{words}, {name}", group, when) for name, group in groups.items() if group]
    return lines


def modulus_line(title: str, cases: Sequence[Scored], when: str) -> str:
    """Share of 90 % intervals that contain the true E, and the relative errors of E."""
    errors = np.array([case.row[when]["value"] / case.label["E_MPa"] - 1 for case in cases])
    truths = [inside(case.row[when]["interval"], case.label["E_MPa"]) for case in cases]
    rms = np.sqrt(np.mean(errors**2))
    return (
        share(f"{title}: inside 90 %", truths)
        + f"; |error| median {np.median(abs(errors)):.1%}, rms {rms:.1%}, most {max(abs(errors)):.0%}"
    )


def case_table(rows: Sequence[Mapping[str, Any]], labels: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One record for each case: truth, verdict, p, and E with its 90 % interval."""
    cases = [scored(row, labels[row["case"]]) for row in rows if "failure" not in row]
    return [
        {
            "case": case.case,
            "kind": case.kind,
            "truth": case.physics or case.truth,
            "category": case.label["category"],
            "law": case.label.get("law", ""),
            "E_true_MPa": case.label["E_MPa"],
            **_columns_of("E_grade", case.row["E_before"]),
            **_columns_of("E_explain", case.row["E_after"]),
            "p_value": case.p,
            "detected": case.detected,
            "verdict": " | ".join(case.verdict),
        }
        for case in cases
    ]


def _columns_of(name: str, modulus: Mapping[str, Any]) -> dict[str, float]:
    low, high = modulus["interval"]
    return {f"{name}_MPa": modulus["value"], f"{name}_low_MPa": low, f"{name}_high_MPa": high}


def curves(singles: Sequence[Scored]) -> list[str]:
    """Of each effect the amplitude at which half is detected and named, and the Cramer-Rao bound."""
    lines = [
        "amplitude of half the cases (in brackets: all or none seen; SD: Cramer-Rao bound, median)",
        f"  {'effect':20s} {'cases':>5s} {'detected':>12s} {'named first':>12s} {'SD':>10s} {'named/SD':>9s}",
    ]
    for effect in sorted({single.truth for single in singles}):
        of_effect = [single for single in singles if single.truth == effect and effect in single.amplitudes]
        stimuli = [single.amplitudes[effect] for single in of_effect]
        bound = np.median(
            [b for single in of_effect if (b := bound_of(single, effect)) is not None] or [np.nan]
        )
        half = [fitted_curve(stimuli, list(map(seen, of_effect))) for seen in SEEN]
        cells = ["-" if c is None else c.half_in_words for c in half]
        ratio = "-" if half[1] is None or not np.isfinite(bound) else f"{half[1].half / bound:.1f}"
        sd = f"{bound:.3g}" if np.isfinite(bound) else "-"
        lines.append(
            f"  {effect:20s} {len(of_effect):5d} {cells[0]:>12s} {cells[1]:>12s} {sd:>10s} {ratio:>9s}"
        )
    for words, stimulus in STIMULI:
        for seen, how in zip(SEEN, ("detected", "named first"), strict=True):
            usable = [single for single in singles if stimulus(single) is not None]
            curve = fitted_curve([stimulus(single) or 0.0 for single in usable], list(map(seen, usable)))
            if curve is not None:
                lines.append(
                    f"half {how} at {words} {curve.half_in_words} "
                    f"(steepness {curve.steepness:.2g}, {curve.seen} of {curve.total})"
                )
    return lines


def bound_of(case: Scored, effect: str) -> float | None:
    """The Cramer-Rao bound of a case's amplitude; a drift's is over the peak force."""
    bound = case.row.get("bounds", {}).get(effect)
    if bound is None:
        return None
    return float(bound) / max(case.row["peaks_N"]) if effect == "sensor_drift" else float(bound)


def amplitude_over_bound(case: Scored) -> float | None:
    """Amplitude of a single effect over its own case's bound; None where there is no bound."""
    bound = bound_of(case, case.truth)
    return None if bound is None or case.truth not in case.amplitudes else case.amplitudes[case.truth] / bound


SEEN: tuple[Callable[[Scored], bool], ...] = (lambda case: case.detected, lambda case: case.named_first)
"""What curves are of: detected, named first."""
STIMULI: tuple[tuple[str, Callable[[Scored], float | None]], ...] = (
    ("amplitude over its Cramer-Rao bound", amplitude_over_bound),
    ("signal over noise", lambda case: signal_over_noise(case.row)),
)
"""What curves over all effects go against."""


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
