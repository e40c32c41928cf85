"""Explain folders of mismatch cases whose answers are known, and count what comes out.

    python benchmarks/mismatch.py FOLDER... [--out CSV] [--limit N] [--ablation NAME ...] [--work DIR]
                                  [--jobs N]

FOLDER holds one folder per case and answers.json, or is one case with answers.json beside it. One JSON line
per case is kept beside the CSV as soon as the case is done: a run that was stopped goes on where it was.
Ablations: whole (the default), load-only (no hold, no unloading), no-grasp-4 (the fruit never turned),
effect-left-out (the true effect is not in the catalogue: right is "unknown"; fruit without mismatch are
passed over), noise-2, noise-4, noise-8 (that many times the noise). The tables are those of the blind tests.
"""

import argparse
import json
import sys
import tempfile
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.append(str(Path(__file__).resolve().parent / "sealed"))
from mismatch_altered import ABLATIONS, LEFT_OUT, WHOLE
from sealed_answers import explained, keep_line, line_of, rows_in
from sealed_report import case_table, report

from fem.mismatch.result import NONE, UNKNOWN


def cases_in(folder: Path) -> list[tuple[Path, dict[str, Any]]]:
    """Cases with their answers."""
    alone = (folder / "case.toml").is_file()
    folders = [folder] if alone else sorted(path.parent for path in folder.glob("*/case.toml"))
    answers = json.loads(((folder.parent if alone else folder) / "answers.json").read_text())
    return [(path, answers[path.name]) for path in folders if path.name in answers]


def label_of(truth: dict[str, Any]) -> dict[str, Any]:
    """An answer as the label of a blind case; amplitudes are unknown."""
    effect = "+".join(sorted(truth["effect"].split("+")))
    kind = {NONE: "sound", UNKNOWN: "outside"}.get(effect, "pair" if "+" in effect else "single")
    return {"kind": kind, "attempts": [{**truth, "effect": effect, "amplitudes": {}}]}


def main() -> None:
    """Run what is not yet done, then write the table and print what it comes to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("mismatch.csv"))
    parser.add_argument("--limit", type=int, default=None, help="at most so many cases")
    parser.add_argument("--ablation", nargs="+", choices=ABLATIONS, default=[WHOLE])
    parser.add_argument("--work", type=Path, default=None, help="keep meshes here between runs")
    parser.add_argument(
        "--jobs", type=int, default=2, help="as of drupe explain; there one per core, at most 4"
    )
    chosen = parser.parse_args()
    lines = chosen.out.with_suffix(".jsonl")
    done = {(row["case"], row["ablation"]): row for row in rows_in(lines)}
    cases = [case for folder in chosen.folders for case in cases_in(folder)][: chosen.limit]
    rows, labels = [], {}
    for folder, truth in cases:
        name = "/".join(folder.resolve().parts[-2:])
        labels[name] = label_of(truth)
        keep = nullcontext(chosen.work / folder.name) if chosen.work else tempfile.TemporaryDirectory()
        with keep as work:
            for ablation in chosen.ablation:
                without = tuple(truth["effect"].split("+")) if ablation == LEFT_OUT else ()
                if without == (NONE,):
                    continue
                if (name, ablation) not in done:
                    row, _ = explained(
                        folder, Path(work), ablation=ablation, jobs=chosen.jobs, without=without
                    )
                    done[name, ablation] = {"case": name, "attempt": 0, **row}
                    keep_line(lines, done[name, ablation])
                    print(line_of(done[name, ablation]), flush=True)
                rows.append(done[name, ablation])
    if not rows:
        raise SystemExit("no case with an answer in answers.json")
    pd.DataFrame(case_table(rows, labels)).to_csv(chosen.out, index=False, float_format="%.6g")
    print("\n".join(report(rows, labels)))
    cpu_s = [row["cpu_s"] for row in rows]
    print(f"a case: {np.median(cpu_s):.0f} s of CPU (most {max(cpu_s):.0f})\n{chosen.out}, {lines}")


if __name__ == "__main__":
    main()
