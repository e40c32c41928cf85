"""Detection statistics of sound cases, and from them the bank that detection is calibrated on.

    python benchmarks/mismatch_nulls.py FOLDER... --rows JSONL [--records R] [--write [--add]]
        [--without EFFECT ...] [--grasps K]

FOLDER holds cases whose answers.json says "none" (`benchmarks/mismatch_bank.py draw`): several noisy
records of each fruit, named null-FRUIT-RECORD, of which R (2) are taken. Each case adds one line to JSONL,
with its p-value by the reference as it stands and what the plain model leaves of the balance of the pads'
forces ("balance", a share of its noise's variance); those that are there are left alone. --write replaces
null_reference.csv and null_quantiles.csv in fem/mismatch/selection by the rows in JSONL; with --add they are
put to the fruits that stand there, and of two quantiles the greater is taken. JSONL is then to hold no fruit
that stands there: fruit of one number, seed and law are one fruit.
--without leaves out of the plain model what it holds of an effect; the amounts in JSONL are then those that
the effects' DiscrepancyPrior states. --grasps takes only the first K recordings of each case,
into a JSONL of its own; their p-values, printed at the end, say how far the reference holds for fewer. Cases
are to be of fruit that are not in the reference, which would else be held against themselves.
"""

import argparse
import csv
import io
import json
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np

from fem.mismatch.catalogue import EFFECTS, SPECS
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.procedure import detected, plain_forward_model
from fem.mismatch.selection.null_reference import (
    QUANTILES_FILE,
    STATISTICS,
    STATISTICS_FILE,
    NullReference,
    null_reference,
)
from fem.mismatch.selection.screening import LinearRound, screened
from fem.mismatch.thresholds import DETECTION_P
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

USUALLY = 0.9
SELECTION = Path(__file__).resolve().parents[1] / "fem" / "mismatch" / "selection"
ORIGIN = """\
# Detection statistics of sound recordings, four grasps a case: noise, surfaces, pits and places are
# drawn anew and nothing is left out on purpose. {cases} cases of {fruits} fruits.
# Pressed by the samples' own contact solver on hexahedra: benchmarks/mismatch_bank.py
# Written by: python benchmarks/mismatch_nulls.py FOLDER... --rows JSONL --write, {written:%Y-%m-%d}
"""
ADDED = """\
# The first {first} fruits stood there before (--add): linear flesh, 2026-11-23, by the equations of before
#   large deformation was part of the plain model, for want of which stiffening gained.
"""
OF_STATISTICS = """\
# best single: gain (ln evidence) of the best effect over the compliance ratio of flesh to gel, beyond the
#   quantile of that effect on the other fruits (null_quantiles.csv); best pair: gain of the best two over the
#   ratio squared; what is left: chi-square of the plain model per number. fruit: whose recording it is.
"""
OF_QUANTILES = """\
# quantile: what nine of ten of these cases stay below of the gain (ln evidence) of an effect over
#   the compliance ratio of flesh to gel; 0 at least.
"""


def row_of(folder: Path, without: Collection[str] = (), grasps: int | None = None) -> dict[str, Any]:
    """The statistics of one case, and how much of every effect seems to be there, the nearest first.

    Of the plain model that p is of (fem.mismatch.procedure.detected; by the null reference of before), and
    of its first `grasps` recordings (None: of all).
    `without`: effects whose seeming amount (fem.mismatch.evidence.discrepancy_prior) is left out of the
    plain model.
    """
    with tempfile.TemporaryDirectory() as work:
        case = open_case(folder, fruit_id=None, work=Path(work), out=None)
        handed = mismatch_case(case, grasped_fruit(case.task, StageLog(str)))
        forward, _ = plain_forward_model(replace(handed, grasps=handed.grasps[:grasps]))
    recorded = [GraspEquations.of(forward, recording) for recording in forward.base.grasps]
    linear = screened(forward, recorded, EFFECTS, without_discrepancy_of=without)
    found = detected(linear, recorded, forward.compliance_ratio)
    shown: dict[str, dict[str, Any]] = {}
    for one in sorted(found.linear.linear_fits, key=lambda own: -own.gain):
        shown.setdefault(
            one.name,
            {
                "gain": round(one.gain, 2),
                "signature": one.signature.label,
                "amounts": [float(f"{amount:.4g}") for amount in one.amounts],
            },
        )
    return {
        "case": f"{folder.parent.name}/{folder.name}",
        **found.statistics,
        "p": found.p_value,
        "balance": balance_left(found.linear, recorded),
        "softness": forward.compliance_ratio,
        "tried": [effect.spec.name for effect in EFFECTS],
        "shown": shown,
    }


def balance_left(linear: LinearRound, recorded: Sequence[GraspEquations]) -> float:
    """Mean square that the plain model leaves of the balance of forces, over the variance it counts with.

    Of W r (fem.mismatch.model.marker_equations) the balance's part is the residual times inverse variance.
    """
    products, fit = linear.products, linear.null
    squares, count = 0.0, 0
    for k, one in enumerate(recorded):
        if one.balance is None:
            continue
        amounts = dict(zip(fit.chosen, fit.amounts, strict=True))
        rows = np.array([1.0, *(-amounts.get(int(j), 0.0) for j in products.rows[k])])
        first = 3 * int((one.recording.tracks.episode >= 0).sum())
        shape = one.balance.measured.shape
        part = (rows @ products.weighed[k])[first : first + one.balance.measured.size].reshape(shape)
        squares += float((part**2 / one.balance.weight).sum())
        count += one.balance.measured.size
    return squares / count if count else float("nan")


def _fruit(row: dict[str, Any]) -> str:
    return str(row["case"]).rsplit("-", 1)[0]


def _gain(row: dict[str, Any], name: str) -> float:
    """An effect's gain over softness."""
    return float(row["shown"][name]["gain"]) / float(row["softness"])


def _usual(rows: list[dict[str, Any]]) -> dict[str, float]:
    """What nine of ten rows stay below, effect by effect; one tried that has no signature gains nothing.

    A row without "tried" is of before that was written down: of what it has a signature of.
    """
    gains = {
        effect: [
            _gain(row, effect) if effect in row["shown"] else 0.0
            for row in rows
            if effect in row["shown"] or effect in row.get("tried", ())
        ]
        for effect in sorted({effect for row in rows for effect in row["shown"]})
    }
    return {name: max(float(np.quantile(own, USUALLY)), 0.0) for name, own in gains.items()}


def files_of(
    rows: list[dict[str, Any]], written: date, *, known: NullReference | None = None
) -> dict[str, str]:
    """Name and text of the two files of the null reference, their origin in their first lines.

    `known`: a reference that the rows are put to.
    """
    usual = _most(_usual(rows), known)
    for row in rows:
        others = [one for one in rows if _fruit(one) != _fruit(row)]
        apart = _most(_usual(others or rows), known)
        row["best single"] = max(_gain(row, name) - apart.get(name, 0.0) for name in row["shown"])
    rows = sorted(rows, key=lambda row: str(row["case"]))
    numbers = {fruit: k for k, fruit in enumerate(dict.fromkeys(_fruit(row) for row in rows))}
    first = 0 if known is None else int(known.fruits.max()) + 1
    lines = (
        []
        if known is None
        else [
            [str(fruit), *(f"{value:.4g}" for value in own)]
            for fruit, own in zip(known.fruits, known.statistics, strict=True)
        ]
    )
    lines += [
        [str(first + numbers[_fruit(row)]), *(f"{row[name]:.4g}" for name in STATISTICS)] for row in rows
    ]
    origin = ORIGIN.format(cases=len(lines), fruits=first + len(numbers), written=written)
    if known is not None:
        origin += ADDED.format(first=first)
    quantiles = [[effect, f"{value:.3g}"] for effect, value in sorted(usual.items())]
    return {
        STATISTICS_FILE: origin + OF_STATISTICS + _csv([["fruit", *STATISTICS], *lines]),
        QUANTILES_FILE: origin + OF_QUANTILES + _csv([["effect", "quantile"], *quantiles]),
    }


def _most(quantiles: dict[str, float], known: NullReference | None) -> dict[str, float]:
    """Of each kind the greater quantile."""
    others = {} if known is None else dict(known.quantiles)
    return {kind: max(quantiles.get(kind, 0.0), others.get(kind, 0.0)) for kind in {**others, **quantiles}}


def _csv(rows: list[list[str]]) -> str:
    with io.StringIO() as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
        return file.getvalue()


def main() -> None:
    """Run what is not yet done, then write the bank where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--rows", type=Path, required=True)
    parser.add_argument("--records", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--add", action="store_true")
    parser.add_argument(
        "--without",
        nargs="+",
        choices=[name for name, spec in SPECS.items() if spec.discrepancy is not None],
        default=[],
    )
    parser.add_argument("--grasps", type=int, choices=[1, 2, 3], default=None)
    chosen = parser.parse_args()
    if chosen.write and chosen.grasps is not None:
        parser.error("--write makes the bank of whole cases: leave --grasps out")
    known = (
        [json.loads(line) for line in chosen.rows.read_text().splitlines()] if chosen.rows.is_file() else []
    )
    if any(row.get("grasps") != chosen.grasps for row in known):
        parser.error(f"{chosen.rows} has rows of another --grasps: name another file")
    done = {row["case"] for row in known}
    for folder in chosen.folders:
        for path in sorted(folder.glob("null-*-*/case.toml")):
            name = f"{folder.name}/{path.parent.name}"
            if name in done or int(path.parent.name.rsplit("-", 1)[1]) > chosen.records:
                continue
            row = row_of(path.parent, chosen.without, chosen.grasps) | {"grasps": chosen.grasps}
            known.append(row)
            with chosen.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(
                row["case"],
                f"p {row['p']:.3f}",
                *(f"{one} {row[one]:.4g}" for one in (*STATISTICS, "balance")),
                next(iter(row["shown"].items())),
                flush=True,
            )
    if chosen.grasps is not None:
        p = [row["p"] for row in known]
        print(
            f"p: {sum(x < DETECTION_P for x in p)} of {len(p)} below {DETECTION_P}, median {np.median(p):.2g}"
        )
    if chosen.write:
        reference = null_reference() if chosen.add else None
        for name, text in files_of(known, datetime.now(UTC).date(), known=reference).items():
            (SELECTION / name).write_text(text)


if __name__ == "__main__":
    main()
