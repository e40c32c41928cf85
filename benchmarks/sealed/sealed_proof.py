"""Verifies and scores the blind tests: seals of the labels, order of the commits, all tables.

    python benchmarks/sealed/sealed_proof.py [--proof DIR] [--csv FILE]

Only committed files are needed. --csv writes one line per case. The exit status is 1 where something is not
as sealed.
"""

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
from sealed_report import case_table, report
from sealing import ANSWERS, LABELS, MANIFEST, SALT, broken_seals, canonical, order_of_commits, read_salt

sys.path.append(str(Path(__file__).resolve().parents[1]))
from script import run

PROOF = Path(__file__).resolve().parent / "proof"
"""Where manifest, answers, salt and labels are."""


def rows_in(path: Path) -> list[dict[str, Any]]:
    """Answers; of two to the same case the first counts. Half a line, which a killed run leaves, is none."""
    known: dict[str, dict[str, Any]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        with suppress(json.JSONDecodeError):
            row = json.loads(line)
            known.setdefault(row["case"], row)
    return list(known.values())


def main(proof: Path = PROOF, csv: Path | None = None) -> int:
    """Verify seals and order, then print the scores; the exit status."""
    seals = json.loads((proof / MANIFEST).read_text(encoding="utf-8"))["seals"]
    rows = rows_in(proof / ANSWERS)
    labels = json.loads((proof / LABELS).read_text(encoding="utf-8"))
    salt = read_salt(proof / SALT)
    broken = broken_seals(seals, {case: salt + canonical(label) for case, label in labels.items()})
    ordered, said = order_of_commits(proof)
    print(
        "\n".join([*said, *broken, f"{len(labels) - len(broken)} of {len(labels)} labels are as sealed", ""])
    )
    print("\n".join(report(rows, labels)))
    if csv is not None:
        pd.DataFrame(case_table(rows, labels)).to_csv(csv, index=False, float_format="%.6g")
    return int(bool(broken) or ordered is False)


if __name__ == "__main__":
    run(main)
