"""Linear rounds of cases with known answers: what the random forest learns from, and cases that tests replay.

    python benchmarks/sealed/bank_features.py FOLDER... --rows JSONL [--stored DIR] [--limit N]

FOLDER holds cases and answers.json (benchmarks/mismatch_bank.py, or one case with answers.json beside it).
Each adds a line to JSONL with its truth and features; those that are there are left alone. With --stored its
linear problem is written to DIR as CASE.npz, with the truth and what the linear round makes of it.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))
from mismatch import cases_in, keep_line
from reduced_case import ReducedCase, gains_of, reduced, store

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.localisation.anova import analysis_of_variance
from fem.mismatch.procedure import plain_forward_model
from fem.mismatch.selection.screening import screened
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog


def problem_of(folder: Path) -> ReducedCase:
    """The linear problem of a case, up to its linear round."""
    with tempfile.TemporaryDirectory() as work:
        case = open_case(folder.resolve(), fruit_id=None, work=Path(work), out=None)
        handed = mismatch_case(case, grasped_fruit(case.task, StageLog(str)))
        forward, fits = plain_forward_model(handed)
    recorded = [GraspEquations.of(forward, recording) for recording in forward.base.grasps]
    found = reduced(forward, recorded, screened(forward, recorded, EFFECTS))
    found.facts["variance"] = {one.factor: one.share for one in analysis_of_variance(forward, fits)}
    return found


def row_of(problem: ReducedCase, folder: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """Truth and features; null cases of one fruit share its name, so that they are parted together."""
    linear = problem.linear()
    name = folder.name
    return {
        "case": f"{folder.parent.name}/{name}",
        "fruit": name.rsplit("-", 1)[0] if name.startswith("null-") else name,
        "truth": truth["effect"],
        "features": {
            "gains": gains_of(linear),
            "statistics": problem.statistics(linear),
            "variance": problem.facts["variance"],
        },
    }


def main() -> None:
    """Run what is not yet done."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--rows", type=Path, required=True)
    parser.add_argument("--stored", type=Path, default=None)
    parser.add_argument("--limit", type=int, default=None)
    chosen = parser.parse_args()
    cases = [one for folder in chosen.folders for one in cases_in(folder)][: chosen.limit]
    for folder, truth in cases:
        lines = chosen.rows.read_text().splitlines() if chosen.rows.is_file() else []
        if f"{folder.parent.name}/{folder.name}" in {json.loads(line)["case"] for line in lines}:
            continue
        problem = problem_of(folder)
        problem.facts["truth"] = truth["effect"]
        problem.facts["verdict"] = problem.linear_verdict(problem.linear())
        if chosen.stored is not None:
            chosen.stored.mkdir(parents=True, exist_ok=True)
            store(chosen.stored / f"{folder.name}.npz", problem)
        row = row_of(problem, folder, truth)
        keep_line(chosen.rows, row)
        print(row["case"], row["truth"], row["features"]["statistics"], flush=True)


if __name__ == "__main__":
    main()
