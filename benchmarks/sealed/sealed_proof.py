"""The sealed proof: cases drawn with a secret salt, answered blind, revealed and checked.

    python benchmarks/sealed/sealed_proof.py draw --salt FILE [--proof DIR]
    python benchmarks/sealed/sealed_proof.py answer --salt FILE [--first K] [--count N] [--cases DIR] [--keep]
                                                     [--ablation NAME ...] [--reduced DIR] [--jobs N]
    python benchmarks/sealed/sealed_proof.py reveal --salt FILE
    python benchmarks/sealed/sealed_proof.py check [--csv FILE] [--salt FILE --unrevealed]

README.md beside this file says in which order, and what is committed when. `answer` goes on where it was;
rows that are there are left alone. `check --unrevealed` scores what is answered so far with labels that only
the holder of the salt can derive, and prints figures that prove nothing yet.
"""

import argparse
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pandas as pd
from mismatch_altered import ABLATIONS, LEFT_OUT
from reduced_case import store
from sealed_answers import explained, keep_line, line_of, rows_in
from sealed_draw import SealedCase, drawn_cases, label_of
from sealed_report import case_table, report
from sealed_simulation import simulated
from sealing import (
    ANSWERS,
    LABELS,
    MANIFEST,
    SALT,
    broken_seals,
    canonical,
    order_of_commits,
    read_salt,
    sealed,
)

from pipeline.batch.cache import code_version
from samples.sample_failure import SampleFailure

PROOF = Path(__file__).resolve().parent / "proof"
"""Where manifest, answers, salt and labels are."""


def draw(proof: Path, salt: str) -> None:
    """Write the manifest; refuses to replace one."""
    path = proof / MANIFEST
    if path.exists():
        raise SystemExit(f"{path} is there already: a manifest is written once")
    seals = {}
    for case in drawn_cases(salt):
        seals[case.case_id] = sealed(salt, label_of(case))
        print(f"{case.case_id} sealed", flush=True)
    proof.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"samples": code_version(("samples",))[:12], "seals": seals}, indent=1) + "\n")


def answer(chosen: argparse.Namespace, salt: str) -> None:
    """Simulate and explain what has no answer yet, a case at a time."""
    seals = json.loads((chosen.proof / MANIFEST).read_text(encoding="utf-8"))["seals"]
    path = chosen.proof / ANSWERS
    cases = drawn_cases(salt)[chosen.first - 1 :][: chosen.count]
    for case in cases:
        done = {(row["case"], row["ablation"]) for row in rows_in(path)}
        left = [one for one in chosen.ablation if (case.case_id, one) not in done]
        if not left:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            folder = (chosen.cases or Path(scratch)) / case.case_id
            if not _is_simulated(folder) and sealed(salt, label_of(case)) != seals[case.case_id]:
                raise SystemExit(
                    f"{case.case_id} is drawn otherwise than sealed: wrong salt, or samples/ changed. "
                    "Simulate it in a checkout of the manifest's commit with --keep --cases DIR, and answer "
                    "it here with the same --cases."
                )
            for row in _rows_of(case, folder, left, chosen):
                keep_line(path, row)
                print(line_of(row), flush=True)
            if not chosen.keep:
                shutil.rmtree(folder, ignore_errors=True)


def _is_simulated(folder: Path) -> bool:
    """Whether the case is kept here, with the facts of its simulation beside it (--keep)."""
    return (folder / "case.toml").is_file() and folder.with_name(f"{folder.name}.json").is_file()


def _rows_of(
    case: SealedCase, folder: Path, ablations: list[str], chosen: argparse.Namespace
) -> list[dict[str, Any]]:
    """Rows of one case; its simulation is read from `folder` where it is there."""
    facts = folder.with_name(f"{case.case_id}.json")
    if not _is_simulated(folder):
        started = time.process_time()
        folder.parent.mkdir(parents=True, exist_ok=True)
        try:
            attempt, peaks = simulated(case, folder)
        except SampleFailure as failure:
            return [{"case": case.case_id, "ablation": ablations[0], "unsimulated": True, "cpu_s": 0.0,
                     "failure": str(failure)}]  # fmt: skip
        facts.write_text(
            json.dumps(
                {"attempt": attempt, "peaks_N": peaks, "simulated_cpu_s": time.process_time() - started}
            )
        )
    own = json.loads(facts.read_text(encoding="utf-8"))
    rows = []
    for ablation in ablations:
        without = tuple(name for name, _ in case.effects) if ablation == LEFT_OUT else ()
        if ablation == LEFT_OUT and not without:
            continue
        with tempfile.TemporaryDirectory() as work:
            row, problem = explained(folder, Path(work), ablation=ablation, jobs=chosen.jobs, without=without)
        if chosen.reduced is not None and problem is not None and ablation == "whole":
            chosen.reduced.mkdir(parents=True, exist_ok=True)
            store(chosen.reduced / f"{case.case_id}.npz", problem)
        rows.append({"case": case.case_id, **own, **row})
    if not chosen.keep:
        facts.unlink()
    return rows


def reveal(proof: Path, salt: str) -> None:
    """Write salt and labels beside the answers."""
    labels = {case.case_id: json.loads(canonical(label_of(case))) for case in drawn_cases(salt)}
    (proof / SALT).write_text(salt + "\n", encoding="utf-8")
    (proof / LABELS).write_text(json.dumps(labels, indent=1) + "\n", encoding="utf-8")


def check(chosen: argparse.Namespace) -> int:
    """Verify seals and order, then print the scores; 1 where something is not as sealed."""
    seals = json.loads((chosen.proof / MANIFEST).read_text(encoding="utf-8"))["seals"]
    rows = rows_in(chosen.proof / ANSWERS)
    if chosen.unrevealed:
        salt = read_salt(chosen.salt)
        wanted = {row["case"] for row in rows}
        labels = {case.case_id: label_of(case) for case in drawn_cases(salt) if case.case_id in wanted}
        broken = broken_seals({name: seals[name] for name in wanted}, salt, labels)
        ordered, said = None, ["not revealed: these figures prove nothing yet"]
    else:
        salt = read_salt(chosen.proof / SALT)
        labels = json.loads((chosen.proof / LABELS).read_text(encoding="utf-8"))
        broken = broken_seals(seals, salt, labels)
        ordered, said = order_of_commits(chosen.proof)
    print(
        "\n".join([*said, *broken, f"{len(labels) - len(broken)} of {len(labels)} labels are as sealed", ""])
    )
    print("\n".join(report(rows, labels)))
    if chosen.csv is not None:
        pd.DataFrame(case_table(rows, labels)).to_csv(chosen.csv, index=False, float_format="%.6g")
    return int(bool(broken) or ordered is False)


def main() -> None:
    """One of the four."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("do", choices=["draw", "answer", "reveal", "check"])
    parser.add_argument("--salt", type=Path, help="file with the salt, outside of the repository")
    parser.add_argument("--proof", type=Path, default=PROOF)
    parser.add_argument("--first", type=int, default=1, help="number of the first case")
    parser.add_argument("--count", type=int, default=None, help="how many cases are looked at")
    parser.add_argument("--cases", type=Path, default=None, help="folder of the simulated cases")
    parser.add_argument("--keep", action="store_true", help="leave the simulated cases there")
    parser.add_argument("--ablation", nargs="+", choices=ABLATIONS, default=["whole"])
    parser.add_argument("--reduced", type=Path, default=None, help="store each case's linear problem here")
    parser.add_argument("--jobs", type=int, default=2, help="threads of an explanation")
    parser.add_argument("--csv", type=Path, default=None, help="file for one line per case")
    parser.add_argument("--unrevealed", action="store_true")
    chosen = parser.parse_args()
    if chosen.do == "check":
        sys.exit(check(chosen))
    if chosen.salt is None:
        parser.error(f"{chosen.do} needs --salt")
    salt = read_salt(chosen.salt)
    if chosen.do == "answer":
        answer(chosen, salt)
    elif chosen.do == "draw":
        draw(chosen.proof, salt)
    else:
        reveal(chosen.proof, salt)


if __name__ == "__main__":
    main()
