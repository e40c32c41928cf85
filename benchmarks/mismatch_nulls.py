"""Detection statistics of sound cases, and from them the bank that detection is calibrated on.

    python benchmarks/mismatch_nulls.py FOLDER... --rows JSONL [--records R] [--write]
        [--without EFFECT ...] [--grasps K]

FOLDER holds cases whose answers.json says "none" (`benchmarks/mismatch_bank.py FOLDER null`): several noisy
records of each fruit, named null-FRUIT-RECORD, of which R (2) are taken. Each case adds one line to JSONL;
those that are there are left alone. --write replaces fem/mismatch/selection/null_reference.py by the rows
in JSONL.
--without leaves out of the plain model what it holds of an effect; the amounts in JSONL are then those that
fem.mismatch.evidence.discrepancy_prior states. --grasps takes only the first K recordings of each case,
into a JSONL of its own; their p-values beside the bank's other fruits, printed at the end, say how far it
holds for fewer.
"""

import argparse
import json
import tempfile
import textwrap
from collections.abc import Collection
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.discrepancy_prior import DISCREPANCY
from fem.mismatch.evidence.linear_evidence import GraspEquations
from fem.mismatch.procedure import detection_statistics, plain_forward_model
from fem.mismatch.selection.detection import LEVEL, NAMES, p_values_beside
from fem.mismatch.selection.null_reference import FRUITS, NULLS
from fem.mismatch.selection.screening import screened
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

USUALLY = 0.9
BANK = Path(__file__).resolve().parents[1] / "fem" / "mismatch" / "selection" / "null_reference.py"


def row_of(folder: Path, without: Collection[str] = (), grasps: int | None = None) -> dict[str, Any]:
    """The statistics of one case, and how much of every effect seems to be there, the nearest first.

    Of its first `grasps` recordings (None: of all).
    `without`: effects whose seeming amount (fem.mismatch.evidence.discrepancy_prior) is left out of the
    plain model.
    """
    with tempfile.TemporaryDirectory() as work:
        case = open_case(folder, fruit_id=None, work=Path(work), out=None)
        handed = mismatch_case(case, grasped_fruit(case.task, StageLog(str)))
        forward, _ = plain_forward_model(replace(handed, grasps=handed.grasps[:grasps]))
    recorded = [GraspEquations.of(forward, recording) for recording in forward.base.grasps]
    discrepancy = {name: own for name, own in DISCREPANCY.items() if name not in without}
    linear = screened(forward, recorded, EFFECTS, discrepancy=discrepancy)
    statistics = detection_statistics(linear, recorded, forward.compliance_ratio)
    shown: dict[str, dict[str, Any]] = {}
    for one in sorted(linear.shown, key=lambda own: -own.gain):
        shown.setdefault(
            one.kind,
            {
                "gain": round(one.gain, 2),
                "signature": one.signature.label,
                "amounts": [float(f"{amount:.4g}") for amount in one.amounts],
            },
        )
    return {
        "case": f"{folder.parent.name}/{folder.name}",
        **statistics,
        "softness": forward.compliance_ratio,
        "shown": shown,
    }


def _fruit(row: dict[str, Any]) -> str:
    return str(row["case"]).rsplit("-", 1)[0]


def _gain(row: dict[str, Any], name: str) -> float:
    """An effect's gain over softness."""
    return float(row["shown"][name]["gain"]) / float(row["softness"])


def _usual(rows: list[dict[str, Any]]) -> dict[str, float]:
    """What nine of ten rows stay below, effect by effect."""
    names = sorted({name for row in rows for name in row["shown"]})
    gains = {name: [_gain(row, name) for row in rows if name in row["shown"]] for name in names}
    return {name: max(float(np.quantile(own, USUALLY)), 0.0) for name, own in gains.items()}


def _p_beside_others(row: dict[str, Any]) -> float:
    """Of the bank without the row's own fruit, which is the bank's number as its name says."""
    bank, fruits = np.array(NULLS), np.array(FRUITS)
    others = fruits != int(_fruit(row).rsplit("-", 1)[1]) - 1
    return p_values_beside({name: row[name] for name in NAMES}, bank[others], fruits[others])[0]


def bank_of(rows: list[dict[str, Any]]) -> str:
    """The source of the module that holds the bank."""
    fruits = {_fruit(row) for row in rows}
    usual = _usual(rows)
    for row in rows:
        others = [one for one in rows if _fruit(one) != _fruit(row)]
        apart = _usual(others or rows)
        row["best single"] = max(_gain(row, name) - apart.get(name, 0.0) for name in row["shown"])
    rows = sorted(rows, key=lambda row: str(row["case"]))
    lines = "".join(f"    ({', '.join(f'{row[name]:.4g}' for name in NAMES)}),\n" for row in rows)
    numbers = {fruit: k for k, fruit in enumerate(dict.fromkeys(_fruit(row) for row in rows))}
    whose = textwrap.fill(
        ", ".join(str(numbers[_fruit(row)]) for row in rows) + ",",
        width=106, initial_indent="    ", subsequent_indent="    ",
    )  # fmt: skip
    return (
        '"""Detection statistics of sound recordings: noise, surfaces, pits and places drawn anew.\n\n'
        f"{len(rows)} cases of four grasps, {len(fruits)} fruits, by the samples' own contact solver on\n"
        "hexahedra (`benchmarks/mismatch_bank.py`), through `benchmarks/mismatch_nulls.py`, "
        f"{datetime.now(UTC):%Y-%m-%d}.\nOne row per case, columns as in NAMES; FRUITS: whose it is. "
        "USUAL: what nine of ten stay below of\neach effect's gain over the softness of the flesh, 0 at "
        'least; a row\'s own best single counts beyond that of\nthe other fruits.\n"""\n\n'
        f"NAMES = {json.dumps(NAMES).replace('[', '(').replace(']', ')')}\n"
        "USUAL: dict[str, float] = {\n"
        + "".join(f'    "{name}": {value:.3g},\n' for name, value in usual.items())
        + "}\n"
        f"NULLS: tuple[tuple[float, ...], ...] = (\n{lines})\n"
        f"FRUITS: tuple[int, ...] = (\n{whose}\n)  # fmt: skip\n"
    )


def main() -> None:
    """Run what is not yet done, then write the bank where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--rows", type=Path, required=True)
    parser.add_argument("--records", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--without", nargs="+", choices=list(DISCREPANCY), default=[])
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
                *(f"{one} {row[one]:.4g}" for one in NAMES),
                next(iter(row["shown"].items())),
                flush=True,
            )
    if chosen.grasps is not None:
        p = [_p_beside_others(row) for row in known]
        print(f"p: {sum(x < LEVEL for x in p)} of {len(p)} below {LEVEL}, median {np.median(p):.2g}")
    if chosen.write:
        BANK.write_text(bank_of(known))


if __name__ == "__main__":
    main()
