"""Measures the model's own error on fruit without mismatch, and the p-values of held-out fruit.

    python benchmarks/model_error_shares.py FOLDER... --rows JSONL [--write | --held-out]

FOLDER holds cases without mismatch (`benchmarks/mismatch_bank.py draw`), named null-FRUIT-RECORD. Each case
adds one line to JSONL: compliance ratio, misfit (chi-square per number), p-value, the p-value of each
statistic, and the square of each effect's apparent share. Cases that have a line are skipped; a case that
fails is printed and left out.
--write writes fem/mismatch/evidence/model_error.csv from all lines of JSONL. --held-out prints how often p is
below 0.05: give it for fruit that the file was not made of, with a JSONL of their own.
"""

import argparse
import csv
import io
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kstest

sys.path.append(str(Path(__file__).resolve().parent / "sealed"))
from sealed_answers import REFUSED, ROOMS, keep_line
from sealed_scores import share

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.model_error import FILE
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.procedure import detected, plain_forward_model
from fem.mismatch.selection.decision import DETECTION_P
from fem.mismatch.selection.screening import LinearRound, screened
from pipeline.batch.cache import code_version
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

EVIDENCE = Path(__file__).resolve().parents[1] / "fem" / "mismatch" / "evidence"
LEAST_SHARE = 0.001
"""Smaller shares are left out of the file. Set by hand: a thousandth of an effect's prior changes nothing."""
ORIGIN = """\
# Apparent amount of each effect without mismatch: root mean square over the prior standard deviation and the
# compliance ratio. {cases} cases of {fruit} fruit, simulated by another solver (benchmarks/mismatch_bank.py).
# Written by: python benchmarks/model_error_shares.py FOLDER... --rows JSONL --write, {written:%Y-%m-%d}
"""


def case_row(folder: Path) -> dict[str, Any]:
    """The line of one case. Misfit and p are of the plain model that the test rests on, flesh that deforms
    largely or moves little; apparent amounts are of the likelier of the two.
    """
    with tempfile.TemporaryDirectory() as work:
        case = open_case(folder, fruit_id=None, work=Path(work), out=None)
        forward, _ = plain_forward_model(mismatch_case(case, grasped_fruit(case.task, StageLog(str))))
    recorded = [GraspEquations.of(forward, recording) for recording in forward.base.grasps]
    linear = screened(forward, recorded, EFFECTS)
    detection = detected(linear)
    squares = squared_shares(equations_without_model_error(linear), compliance_ratio=forward.compliance_ratio)
    return {
        "case": f"{folder.parent.name}/{folder.name}",
        "code": code_version(ROOMS)[:12],
        "compliance_ratio": forward.compliance_ratio,
        "misfit": detection.linear.null.chi2 / detection.linear.numbers,
        "p": detection.p_value,
        "p_values": detection.p_values,
        "squared_shares": {effect: float(f"{square:.6g}") for effect, square in squares.items()},
    }


def equations_without_model_error(linear: LinearRound) -> SignatureEquations:
    """Equations of all signatures beside a plain model without model error columns."""
    signatures: dict[str, list[tuple[int, ...]]] = {}
    for fit in linear.linear_fits:
        signatures.setdefault(fit.name, []).append(fit.columns)
    nuisances = [j for j in linear.nuisances if linear.products.columns[j].same_as is None]
    return SignatureEquations.of(linear.products, nuisances, signatures)


def squared_shares(equations: SignatureEquations, *, compliance_ratio: float) -> dict[str, float]:
    """Square of each effect's apparent amount over prior standard deviation and compliance ratio, noise
    removed: the median over all columns of its signatures, each signature fitted alone.

        a = (N + L)^-1 b,      x = max(a^2 - v, 0) / (sd ratio)^2,      v = diag (N + L)^-1
    """
    squares = {}
    for effect, ways in equations.ways.items():
        each: list[float] = []
        for columns in ways:
            at, sd = list(columns), equations.sd[list(columns)]
            covariance = np.linalg.inv(equations.normal[np.ix_(at, at)] + np.diag(sd**-2.0))
            amounts = covariance @ equations.right[at]
            each += list(np.maximum(amounts**2 - np.diag(covariance), 0.0) / (sd * compliance_ratio) ** 2)
        if each:
            squares[effect] = float(np.median(each))
    return squares


def model_error_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The share of each effect, by name: root mean square over the cases that have its signature."""
    effects = sorted({effect for row in rows for effect in row["squared_shares"]})
    return {
        effect: float(
            np.sqrt(
                np.mean([row["squared_shares"][effect] for row in rows if effect in row["squared_shares"]])
            )
        )
        for effect in effects
    }


def file_text(rows: Sequence[Mapping[str, Any]], written: date) -> str:
    """Text of model_error.csv; its first lines say from how many cases it is, and by which command."""
    with io.StringIO() as file:
        file.write(ORIGIN.format(cases=len(rows), fruit=len(set(map(fruit_of, rows))), written=written))
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["effect", "share"])
        lines.writerows(
            [effect, f"{size:.3g}"] for effect, size in model_error_of(rows).items() if size >= LEAST_SHARE
        )
        return file.getvalue()


def fruit_of(row: Mapping[str, Any]) -> str:
    """A case's fruit: its name without the number of the record."""
    return str(row["case"]).rsplit("-", 1)[0]


def held_out_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Share of p below the level of detection, and p of one case a fruit against the uniform."""
    first: dict[str, float] = {}
    for row in sorted(rows, key=lambda row: str(row["case"])):
        first.setdefault(fruit_of(row), row["p"])
    uniform = kstest(list(first.values()), "uniform").pvalue
    return [
        share(f"p below {DETECTION_P:g}", [row["p"] < DETECTION_P for row in rows]),
        f"  Kolmogorov and Smirnov, p of one case of {len(first)} fruit against the uniform: {uniform:.2g}",
        "  states of the code: " + ", ".join(sorted({str(row["code"]) for row in rows})),
    ]


def main() -> None:
    """Run what is not yet done, then write the file or print p-values where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--rows", type=Path, required=True)
    purpose = parser.add_mutually_exclusive_group()
    purpose.add_argument("--write", action="store_true")
    purpose.add_argument("--held-out", action="store_true")
    chosen = parser.parse_args()
    text = chosen.rows.read_text(encoding="utf-8") if chosen.rows.is_file() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    done = {row["case"] for row in rows}
    for path in (path for folder in chosen.folders for path in sorted(folder.glob("null-*-*/case.toml"))):
        folder = path.parent.resolve()
        name = f"{folder.parent.name}/{folder.name}"
        if name in done:
            continue
        try:
            row = case_row(folder)
        except REFUSED as failure:
            print(f"{name}: {failure}", flush=True)
            continue
        rows.append(row)
        keep_line(chosen.rows, row)
        each = ", ".join(f"{statistic} {p:.3f}" for statistic, p in row["p_values"].items())
        print(f"{name}: misfit {row['misfit']:.4f}, p {row['p']:.3f} ({each})", flush=True)
    if not rows:
        raise SystemExit(f"{chosen.rows} has no line, and no case was computed")
    if chosen.write:
        (EVIDENCE / FILE).write_text(file_text(rows, datetime.now(UTC).date()), encoding="utf-8")
    if chosen.held_out:
        print("\n".join(held_out_lines(rows)))


if __name__ == "__main__":
    main()
