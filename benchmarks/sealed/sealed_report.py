"""What the sealed proof comes to, as lines of text."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from other_methods import method_table
from psychometric import fitted_curve
from scipy.stats import kstest
from sealed_scores import Scored, inside, parameter_rows, scored, share, signal_over_noise

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
    sound = [case for case in cases if case.kind == "sound"]
    singles = [case for case in cases if case.kind == "single"]
    pairs = [case for case in cases if case.kind == "pair"]
    outside = [case for case in cases if case.kind == "outside"]
    plain = [single for single in singles if single.signal > PLAIN_SIGNAL]
    covered = [one.covered for one in (*singles, *pairs) if one.detected]
    wrong = [one.detected and not one.unknown and not one.related for one in outside]
    return [
        share("false alarms in sound cases", [one.detected for one in sound]),
        *(
            share(f"  {law} flesh", [one.detected for one in sound if one.label.get("law") == law])
            for law in sorted({one.label["law"] for one in sound if "law" in one.label})
        ),
        share("single effects detected", [single.detected for single in singles]),
        share(f"  named first, signal/noise over {PLAIN_SIGNAL:g}", [one.named_first for one in plain]),
        share("  named first, all", [single.named_first for single in singles]),
        share("pairs with both named", [pair.both_named for pair in pairs]),
        share("  one of the two in the verdict", [_one_of_two(pair) for pair in pairs]),
        share("verdict covers the truth, where something was found", covered),
        share("outside the catalogue: called unknown", [one.unknown for one in outside]),
        share("  unknown or a relative", [one.unknown or one.related for one in outside]),
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


def _one_of_two(one: Scored) -> bool:
    said = {part for name in one.verdict for part in name.split("+")}
    return bool(said & set(one.truth.split("+")))


def confusion(cases: Sequence[Scored]) -> list[str]:
    """Truth to verdicts, commonest first; the matrix's zeros left out."""
    found: dict[str, Counter[str]] = {}
    for case in cases:
        truth = f"{case.truth} ({case.physics})" if case.physics else case.truth
        found.setdefault(truth, Counter())[" | ".join(case.verdict)] += 1
    return ["truth: verdicts"] + [
        f"  {truth:34s} " + "  ".join(f"{count} x [{said}]" for said, count in own.most_common())
        for truth, own in sorted(found.items())
    ]


def name_probabilities(cases: Sequence[Scored]) -> list[tuple[float, bool]]:
    """Of each case in which something was found: the first name's probability, and whether it is true."""
    found = []
    for case in cases:
        first = next((c for c in case.row["ranking"] if c["effect"] != "none"), None)
        if case.detected and first is not None:
            found.append((float(first["probability"]), first["effect"] == case.truth))
    return found


def reliability(cases: Sequence[Scored]) -> list[str]:
    """p of sound cases by tenths and against the uniform; probabilities of first names against truth."""
    p = np.array([case.p for case in cases if case.kind == "sound"])
    counts = np.histogram(p, TENTHS, (0.0, 1.0))[0]
    lines = [f"p of {len(p)} sound cases by tenths: {' '.join(map(str, counts))}"]
    if len(p) > 1:
        lines.append(f"  Kolmogorov and Smirnov against the uniform: {kstest(p, 'uniform').pvalue:.2g}")
    said = name_probabilities(cases)
    lines.append("probability of the first name: mean said, share true, cases")
    for low, high in pairwise(PROBABILITIES):
        own = [(q, true) for q, true in said if low <= q < high or (high == 1.0 and q == 1.0)]
        if own:
            mean = np.mean([q for q, _ in own])
            lines.append(
                f"  {low:.2f} to {high:.2f}: {mean:.2f}, {np.mean([t for _, t in own]):.2f}, {len(own)}"
            )
    return lines


def coverage(cases: Sequence[Scored]) -> list[str]:
    """90 % intervals of parameters, and of E before and after by kind of case, whatever the verdict."""
    rows = [row for case in cases for row in parameter_rows(case)]
    held = [bool(ok) for _, _, ok in rows if ok is not None]
    lines = [share("parameters inside their 90 % intervals", held)]
    by_name: dict[str, list[tuple[float, bool | None]]] = {}
    for name, error, ok in rows:
        by_name.setdefault(name, []).append((error, ok))
    if rows:
        lines.append(f"  median |relative error| {np.median([error for _, error, _ in rows]):.1%}")
    for name, own in sorted(by_name.items()):
        errors, known = [error for error, _ in own], [ok for _, ok in own if ok is not None]
        lines.append(f"  {name:34s} {np.median(errors):7.1%}  inside {sum(known)} of {len(known)}")
    groups = {kind: [case for case in cases if kind in ("all", case.kind)] for kind in KINDS}
    for category in sorted({str(case.label.get("category")) for case in cases}):
        groups[f"sound {category}"] = [
            one for one in groups["sound"] if str(one.label.get("category")) == category
        ]
    for when, words in (("E_before", "E without an effect"), ("E_after", "E in the end")):
        lines += [modulus_line(f"{words}, {name}", own, when) for name, own in groups.items() if own]
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
    table = []
    for one in (scored(row, labels[row["case"]]) for row in rows if "failure" not in row):
        (low, high), (graded_low, graded_high) = (
            one.row["E_after"]["interval"],
            one.row["E_before"]["interval"],
        )
        table.append(
            {
                "case": one.case,
                "kind": one.kind,
                "truth": one.physics or one.truth,
                "category": one.label["category"],
                "law": one.label.get("law", ""),
                "E_true_MPa": one.label["E_MPa"],
                "E_grade_MPa": one.row["E_before"]["value"],
                "E_grade_low_MPa": graded_low,
                "E_grade_high_MPa": graded_high,
                "E_explain_MPa": one.row["E_after"]["value"],
                "E_explain_low_MPa": low,
                "E_explain_high_MPa": high,
                "p_value": one.p,
                "detected": one.detected,
                "verdict": " | ".join(one.verdict),
            }
        )
    return table


def curves(singles: Sequence[Scored]) -> list[str]:
    """Of each effect the amplitude at which half is detected and named, and the Cramer-Rao bound."""
    lines = [
        "amplitude of half the cases (in brackets: all or none seen; SD: Cramer-Rao bound, median)",
        f"  {'effect':20s} {'cases':>5s} {'detected':>12s} {'named first':>12s} {'SD':>10s} {'named/SD':>9s}",
    ]
    for effect in sorted({single.truth for single in singles}):
        own = [single for single in singles if single.truth == effect and effect in single.amplitudes]
        stimuli = [one.amplitudes[effect] for one in own]
        bound = np.median([b for one in own if (b := bound_of(one, effect)) is not None] or [np.nan])
        half = [fitted_curve(stimuli, list(map(seen, own))) for seen in SEEN]
        cells = ["-" if c is None else _bracketed(f"{c.half:.3g}", c.bracketed) for c in half]
        ratio = "-" if half[1] is None or not np.isfinite(bound) else f"{half[1].half / bound:.1f}"
        sd = f"{bound:.3g}" if np.isfinite(bound) else "-"
        lines.append(f"  {effect:20s} {len(own):5d} {cells[0]:>12s} {cells[1]:>12s} {sd:>10s} {ratio:>9s}")
    for words, stimulus in STIMULI:
        for seen, how in zip(SEEN, ("detected", "named first"), strict=True):
            usable = [single for single in singles if stimulus(single) is not None]
            curve = fitted_curve([stimulus(one) or 0.0 for one in usable], list(map(seen, usable)))
            if curve is not None:
                lines.append(
                    f"half {how} at {words} {_bracketed(f'{curve.half:.3g}', curve.bracketed)} "
                    f"(steepness {curve.steepness:.2g}, {curve.seen} of {curve.total})"
                )
    return lines


def _bracketed(text: str, bracketed: bool) -> str:
    return text if bracketed else f"({text})"


def bound_of(one: Scored, effect: str) -> float | None:
    """The Cramer-Rao bound of a case's amplitude; a drift's is over the peak force."""
    bound = one.row.get("bounds", {}).get(effect)
    if bound is None:
        return None
    return float(bound) / max(one.row["peaks_N"]) if effect == "sensor_drift" else float(bound)


def amplitude_over_bound(one: Scored) -> float | None:
    """Amplitude of a single effect over its own case's bound; None where there is no bound."""
    bound = bound_of(one, one.truth)
    return None if bound is None or one.truth not in one.amplitudes else one.amplitudes[one.truth] / bound


SEEN: tuple[Callable[[Scored], bool], ...] = (lambda one: one.detected, lambda one: one.named_first)
"""What curves are of: detected, named first."""
STIMULI: tuple[tuple[str, Callable[[Scored], float | None]], ...] = (
    ("amplitude over its Cramer-Rao bound", amplitude_over_bound),
    ("signal over noise", lambda one: signal_over_noise(one.row)),
)
"""What curves over all effects go against."""
