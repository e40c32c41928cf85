"""Scores of the mismatch decision on stored rounds, and the model's own error measured on them.

    python benchmarks/mismatch_scores.py ROUNDS [--error-of-other-fruit] [--figure PNG] [--csv FILE]
    python benchmarks/mismatch_scores.py ROUNDS --write-model-error

ROUNDS holds linear rounds of cases with answers (`benchmarks/mismatch_bank.py reduce`). Every case is decided
again with today's decision and the shipped model error, by linear signatures alone. `benchmarks/mismatch.py`
scores answers of `drupe explain`, which has full models. --error-of-other-fruit: with the error that fruit of
the other thirds show. --write-model-error writes
fem/mismatch/evidence/model_error.csv from the cases without mismatch, and scores nothing.

"Named first" means detected, and the likeliest explanation but none is the true one. E is the plain model's
changed by linear signatures, averaged over the posterior; the plain E has a relative error of PLAIN_E_SD.
"""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.special import polygamma
from scipy.stats import kstest
from script import run

sys.path.append(str(Path(__file__).resolve().parent / "sealed"))
from apparent_shares import ModelError, file_text, fruit_of, large_deformation_line, null_cases
from clustered_share import clustered_interval
from ideal_confusion import ideal_names
from psychometric import Curve, fitted_curve
from reduced_case import ReducedCase, stored
from score_figure import RELIABILITY_BINS, score_figure
from scored_round import PLAIN_E_SD, ScoredRound, posterior, scored_round
from sealed_report import modulus_line, reliability_bins
from sealed_scores import Scored, share

from fem.mismatch.evidence.model_error import FILE
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection import decision
from fem.mismatch.selection.decision import DETECTION_P
from reports.figures import png_of

EVIDENCE = Path(__file__).resolve().parents[1] / "fem" / "mismatch" / "evidence"
TEMPERATURES, PRIORS_OF_NONE = (1.0, 1.25, 1.5, 2.0, 3.0), (0.5, 0.7)
"""Tried for the log score."""
LEAST_PROBABILITY = 1e-3
"""Of the true explanation in the log score: a pair that was not tried has none."""
ABOVE_BOUND = 2.0
"""Amplitude over its noise-only bound from which an effect should be named. Set by hand."""
MULTIPLES, DRAWS = (2, 4, 8), 200
"""Of the ideal confusions: full bounds, and draws of each effect and multiple."""
FOLDS = 3
"""Parts of the fruit; the model error for one is measured on the others."""


def false_alarms(title: str, p: Sequence[tuple[str, float]]) -> list[str]:
    """Of cases without mismatch, as fruit and p: how often p is small, and whether it is uniform."""
    alarms = [p_value < DETECTION_P for _, p_value in p]
    low, high = clustered_interval([fruit for fruit, _ in p], alarms)
    by_fruit = pd.DataFrame(p, columns=["fruit", "p"]).groupby("fruit", sort=False)["p"]
    uniform = kstest(by_fruit.first(), "uniform").pvalue
    return [
        f"{title}: p < {DETECTION_P:g} in {sum(alarms)} of {len(alarms)} = {np.mean(alarms):.1%} "
        f"({low:.1%} to {high:.1%}, beta-binomial over {len(by_fruit)} fruit)",
        f"  Kolmogorov and Smirnov, the first case of each fruit against the uniform: {uniform:.2g}",
        *(f"  {fruit}: {' '.join(f'{x:.3f}' for x in each)}" for fruit, each in by_fruit),
    ]


def errors_of_other_fruit(cases: Mapping[str, ReducedCase]) -> dict[str, ModelError]:
    """The model error for each fruit, measured without mismatch on those of the other FOLDS - 1 folds."""
    nulls = null_cases({name: case for name, case in cases.items() if is_null(case)})
    fruits = sorted({fruit_of(name, case) for name, case in cases.items()})
    fold = {fruit: k % FOLDS for k, fruit in enumerate(fruits)}
    by_fold = {
        left_out: ModelError.of([null for null in nulls if fold[null.fruit] != left_out])
        for left_out in set(fold.values())
    }
    return {fruit: by_fold[left_out] for fruit, left_out in fold.items()}


def is_null(case: ReducedCase) -> bool:
    """Whether the answer is no mismatch."""
    return bool(case.facts["answer"]["effect"] == NONE)


def single_lines(rounds: Sequence[ScoredRound]) -> list[str]:
    """Single effects and pairs: detected, named first, in the verdict's set."""
    singles = [each for each in rounds if each.scored.kind == "single"]
    visible = [each for each in singles if (each.over_bound(0) or 0.0) > ABOVE_BOUND]
    pairs = [each.scored for each in rounds if each.scored.kind == "pair"]
    outside = [each.scored for each in rounds if each.scored.kind == "outside"]
    lines = [f"  {'effect':20s} {'cases':>5s} {'detected':>9s} {'first':>6s} {'in set':>7s} {'set size':>9s}"]
    for effect in sorted({each.scored.truth for each in singles}):
        cases = [each.scored for each in singles if each.scored.truth == effect]
        first = sum(case.named_first for case in cases)
        size = np.mean([len(case.verdict) for case in cases])
        lines.append(
            f"  {effect:20s} {len(cases):5d} {sum(case.detected for case in cases):9d} {first:6d} "
            f"{sum(case.covered for case in cases):7d} {size:9.2f}"
        )
    for title, group in (("single effects", singles), (f"  above {ABOVE_BOUND:g} bounds of noise", visible)):
        cases = [each.scored for each in group]
        sizes = [len(case.verdict) for case in cases]
        lines += [
            share(f"{title}: detected", [case.detected for case in cases]),
            share(f"{title}: named first", [case.named_first for case in cases]),
            share(f"{title}: in the verdict's set", [case.covered for case in cases]),
            *([f"{title}: mean size of the set {np.mean(sizes):.2f}"] if sizes else []),
        ]
    return [
        *lines,
        share("pairs: both named", [case.both_named for case in pairs]),
        share("outside the catalogue: unknown in the set", [UNKNOWN in case.verdict for case in outside]),
    ]


def curves(
    rounds: Sequence[ScoredRound], which: int
) -> tuple[list[float], list[list[bool]], list[Curve | None]]:
    """Amplitudes over a bound, whether each was detected and named first, and the curves of both."""
    known = [each for each in rounds if each.scored.kind == "single" and each.over_bound(which) is not None]
    stimuli = [each.over_bound(which) or 0.0 for each in known]
    seen = [[each.scored.detected for each in known], [each.scored.named_first for each in known]]
    return stimuli, seen, [fitted_curve(stimuli, each) for each in seen]


def bound_lines(rounds: Sequence[ScoredRound]) -> list[str]:
    """Amplitude over its bound at which half are detected and named, and how much the bound loses."""
    lines = [
        "amplitude over bound of half the cases, by noise alone and in full (brackets: all or none seen)",
        f"  {'effect':20s} {'cases':>5s} {'detected':>8s} {'named':>8s} {'det. full':>9s} {'named full':>10s}"
        f" {'loss':>6s}",
    ]
    truths = sorted({each.scored.truth for each in rounds if each.over_bound(0) is not None})
    for effect in ("all", *truths):
        group = [each for each in rounds if effect in ("all", each.scored.truth)]
        halves = [
            "-" if curve is None else curve.half_in_words for k in (0, 1) for curve in curves(group, k)[2]
        ]
        count = len(curves(group, 0)[0])
        lost = [_loss(each, each.scored.truth) for each in group if each.over_bound(0) is not None]
        lines.append(
            f"  {effect:20s} {count:5d} {halves[0]:>8s} {halves[1]:>8s} {halves[2]:>9s} {halves[3]:>10s} "
            f"{np.median(lost) if lost else np.nan:6.1f}"
        )
    every = sorted({effect for each in rounds for effect in each.bounds})
    losses = [
        f"{effect} {np.median([_loss(each, effect) for each in rounds if effect in each.bounds]):.1f}"
        for effect in every
    ]
    return [*lines, "loss sqrt(I_noise / I_full), median over all cases with bounds: " + ", ".join(losses)]


def _loss(each: ScoredRound, effect: str) -> float:
    noise, full = each.bounds[effect]
    return full / noise


def log_score_lines(rounds: Sequence[ScoredRound]) -> list[str]:
    """Mean log probability of the truth by temperature and prior of none, without and with mismatch."""
    none = [each for each in rounds if each.scored.kind == "sound"]
    other = [each for each in rounds if each.scored.kind != "sound"]
    shipped = f"prior {decision.PRIOR[NONE]:g}, temperature {decision.TEMPERATURE:g}"
    lines = [f"mean log score of the truth, at least ln {LEAST_PROBABILITY:g} (shipped: {shipped})"]
    for prior in PRIORS_OF_NONE:
        left = (1 - prior) / (1 - decision.PRIOR[NONE])
        priors = {kind: prior if kind == NONE else left * p for kind, p in decision.PRIOR.items()}
        for temperature in TEMPERATURES:
            with patch.multiple(decision, TEMPERATURE=temperature, PRIOR=priors):
                scores = [[log_score(each) for each in group] for group in (none, other, rounds)]
            words = " ".join(f"{np.mean(group):8.3f}" if group else f"{'-':>8s}" for group in scores)
            lines.append(f"  prior of none {prior:g}, temperature {temperature:4.2f}: {words}")
    return [*lines, f"  columns: {len(none)} without mismatch, {len(other)} with, all"]


def log_score(each: ScoredRound) -> float:
    """ln of the posterior probability of the true explanation."""
    return float(
        np.log(max(dict(posterior(each.explanations)).get(each.scored.truth, 0.0), LEAST_PROBABILITY))
    )


def modulus_lines(cases: Sequence[Scored]) -> list[str]:
    """Coverage of E by kind of verdict."""
    kinds: dict[str, list[Scored]] = {"all": list(cases)}
    for case in cases:
        single = case.verdict[0] if case.verdict[0] in (NONE, UNKNOWN) else "one name"
        kinds.setdefault(single if len(case.verdict) == 1 else "several", []).append(case)
    return [
        f"E, with {PLAIN_E_SD:.0%} for the plain model's own error",
        *(modulus_line(f"  verdict {kind}", group, "E_after") for kind, group in kinds.items()),
    ]


def ideal_lines(rounds: Sequence[ScoredRound]) -> list[str]:
    """How often each effect would come first if the linear model were exact, and what takes it."""
    first = {each.fruit: each.linear for each in rounds if each.scored.kind == "sound"}
    named = ideal_names(list(first.values()), multiples=MULTIPLES, draws=DRAWS, rng=np.random.default_rng(0))
    lines = [
        f"ideal: first of the posterior at {', '.join(map(str, MULTIPLES))} full bounds (pairs left out), "
        f"most often instead at {MULTIPLES[-1]} bounds"
    ]
    for effect in sorted({effect for effect, _ in named}):
        shares = [named[effect, k][effect] / named[effect, k].total() for k in MULTIPLES]
        most = Counter({n: c for n, c in named[effect, MULTIPLES[-1]].items() if n != effect}).most_common(2)
        total = named[effect, MULTIPLES[-1]].total()
        taken = ", ".join(f"{name} {count / total:.0%}" for name, count in most)
        lines.append(f"  {effect:20s} {' '.join(f'{x:5.0%}' for x in shares)}   {taken}")
    return lines


def usual_misfit(misfit: Sequence[tuple[str, float]]) -> tuple[float, float]:
    """Mean over cases without mismatch, as fruit and chi-square per number, and the degrees of freedom f of
    the chi-square that it scatters as: trigamma(f / 2) is the variance of its logarithm between fruit.
    """
    fruit, shares = zip(*misfit, strict=True)
    variance = pd.Series(np.log(shares)).groupby(np.array(fruit)).mean().var()
    freedom = brentq(lambda f: polygamma(1, f / 2) - variance, 0.1, 1e4)
    return float(np.mean(shares)), float(freedom)


def misfit_of(each: ScoredRound) -> float:
    """Chi-square per number that the plain model leaves."""
    return each.linear.null.chi2 / each.linear.numbers


def tables(rounds: Sequence[ScoredRound]) -> list[str]:
    """Everything that is printed."""
    cases = [each.scored for each in rounds]
    none = [each for each in rounds if each.scored.kind == "sound"]
    lines = [f"{len(cases)} cases of {len({each.fruit for each in rounds})} fruit", ""]
    if none:
        lines += false_alarms("without mismatch", [(each.fruit, each.scored.p) for each in none])
        if len({each.fruit for each in none}) > 1:
            usual, freedom = usual_misfit([(each.fruit, misfit_of(each)) for each in none])
            lines.append(f"  misfit: mean {usual:.4f}, degrees of freedom {freedom:.1f}")
    return [
        *lines,
        "",
        *single_lines(rounds),
        "",
        *bound_lines(rounds),
        "",
        *log_score_lines(rounds),
        "",
        "probability of the first name where a mismatch was detected: stated, share right, right of cases",
        *(
            f"  {p:.2f} {right:.2f} {count} of {total}"
            for p, right, count, total in reliability_bins(cases, RELIABILITY_BINS).values()
        ),
        "",
        *modulus_lines(cases),
        *(["", *ideal_lines(rounds)] if none else []),
    ]


def table_row(each: ScoredRound) -> dict[str, Any]:
    """One line of the table of all cases."""
    case, first = each.scored, next(r for r in each.scored.row["ranking"] if r["effect"] != NONE)
    return {
        "case": case.case, "fruit": each.fruit, "kind": case.kind, "truth": case.truth,
        "amplitude": case.amplitudes.get(case.truth), "over_noise_bound": each.over_bound(0),
        "over_full_bound": each.over_bound(1), "p_value": case.p, "detected": case.detected,
        "first": first["effect"], "probability": first["probability"], "set": " | ".join(case.verdict),
        "log_score": log_score(each), "E_true_MPa": case.label["E_MPa"],
        "misfit": misfit_of(each),
        "E_plain_MPa": case.row["E_before"]["value"], "E_MPa": case.row["E_after"]["value"],
        **{f"p_{name}": p for name, p in each.detection.p_values.items()},
    }  # fmt: skip


def loaded(folder: Path) -> dict[str, ReducedCase]:
    """Stored rounds by name. Exits if there are no rounds."""
    paths = sorted(path for path in folder.glob("*.npz") if not path.name.endswith(".partial.npz"))
    if not paths:
        raise SystemExit(f"{folder} has no stored round (*.npz): write them with mismatch_bank.py reduce")
    return {path.stem: stored(path) for path in paths}


def main(
    rounds: Path,
    error_of_other_fruit: bool = False,
    write_model_error: bool = False,
    figure: Path | None = None,
    csv: Path | None = None,
) -> None:
    """Write the model error, or print the scores."""
    cases = loaded(rounds)
    nulls = {name: case for name, case in cases.items() if is_null(case)}
    if write_model_error:
        if not nulls:
            raise SystemExit(f"{rounds} has no round without mismatch")
        measured = null_cases(nulls)
        command = "python benchmarks/mismatch_scores.py ROUNDS --write-model-error"
        text = file_text(measured, ModelError.of(measured), command=command, written=datetime.now(UTC).date())
        (EVIDENCE / FILE).write_text(text, encoding="utf-8")
        print(text)
        return
    errors = errors_of_other_fruit(cases) if error_of_other_fruit else {}
    scores = [scored_round(name, case, errors.get(fruit_of(name, case))) for name, case in cases.items()]
    print("\n".join(tables(scores)))
    print(large_deformation_line(list(nulls.values())))
    if csv is not None:
        pd.DataFrame([table_row(each) for each in scores]).to_csv(csv, index=False)
    if figure is not None:
        stimuli, seen, _ = curves(scores, 1)
        words = "amplitude over its bound (model error included)"
        figure.write_bytes(png_of(score_figure(stimuli, seen, [each.scored for each in scores], words)))


if __name__ == "__main__":
    run(main)
