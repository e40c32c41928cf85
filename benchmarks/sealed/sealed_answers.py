"""Explains a case's folder, blind: all that is known of it is what `drupe explain` reads.

A row of the answers is one JSON line: verdict, ranking with probabilities and parameters, p, E before and
after with 90 % intervals, what is held out, cost, and what the score needs without the case's files
(gains, Cramer-Rao bounds). Rows are added one at a time, by several runs and machines.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from cramer_rao import amplitude_bounds, information_of
from mismatch_altered import altered
from parameter_errors import NINETY
from reduced_case import ReducedCase, gains_of, reduced

from fem.fem_failure import FemFailure
from fem.mismatch import procedure
from fem.mismatch.result import Candidate, Explanation, Modulus
from fem.mismatch.selection.decision import MISFIT
from pipeline.batch.cache import code_version
from pipeline.batch.outcome import FruitEnded
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import finding
from pipeline.fruit.stage_log import StageLog
from pipeline.problem import BatchRefused
from recon.recon_failure import ReconFailure
from tactile.tactile_failure import TactileFailure

REFUSED = (BatchRefused, FruitEnded, ReconFailure, TactileFailure, FemFailure)
BROKEN = (ArithmeticError, LookupError, MemoryError, RuntimeError, TypeError, ValueError, AttributeError)
"""A defect in one case must not cost the others; it is counted as a case without an answer."""
ROOMS = ("fem", "tactile", "recon", "pipeline")


@dataclass
class Captured:
    """What goes by while a case is explained: its first linear round and the information in it."""

    case: ReducedCase | None = None
    information: np.ndarray | None = None


@contextmanager
def captured() -> Iterator[Captured]:
    """While it holds, the finder's linear problem is kept."""
    found = Captured()
    screened = procedure.screened

    def screening(forward: Any, recorded: Any, effects: Any, **more: Any) -> Any:
        linear = screened(forward, recorded, effects, **more)
        if found.case is None:
            found.case = reduced(forward, recorded, linear)
            found.information = information_of(forward, linear)
        return linear

    with patch.object(procedure, "screened", screening):
        yield found


def explained(
    folder: Path, work: Path, *, ablation: str, jobs: int, without: tuple[str, ...] = ()
) -> tuple[dict[str, Any], ReducedCase | None]:
    """The row of one case, and its linear problem; a failure is a row too.

    `without`: effects that are not in the catalogue under the ablation LEFT_OUT; the machine reads them from
    the label, and nothing else of it.
    """
    started, busy = time.perf_counter(), time.process_time()
    row: dict[str, Any] = {"ablation": ablation, "code": code_version(ROOMS)[:12]}
    problem = None
    try:
        with altered(ablation, "+".join(without)), captured() as kept:
            case = open_case(folder.resolve(), fruit_id=None, work=work, out=None)
            found = finding(case, StageLog(str), jobs=jobs).explanation
        row |= answered(found)
        row["seconds"] = round(time.perf_counter() - started, 1)
        row["cpu_s"] = round(time.process_time() - busy, 1)
        problem = kept.case
        if problem is not None and kept.information is not None:
            row |= of_problem(problem)
            row["bounds"] = amplitude_bounds(kept.information, problem, E_MPa=found.before.value)
    except REFUSED as failure:
        row["failure"] = " ".join(str(failure).split())
    except BROKEN as defect:
        row["failure"] = f"{type(defect).__name__}: {defect}"
    row.setdefault("cpu_s", round(time.process_time() - busy, 1))
    return row, problem


def answered(found: Explanation) -> dict[str, Any]:
    """What an explanation says, as plain JSON values."""
    verdict = [found.verdict] if isinstance(found.verdict, str) else list(found.verdict)
    return {
        "verdict": ["+".join(sorted(one.split("+"))) for one in verdict],
        "detected": found.detected,
        "p": found.p_value,
        "statistics": found.statistics,
        "ranking": [_candidate(one) for one in found.ranking[:8]],
        "E_before": _modulus(found.before),
        "E_after": _modulus(found.after),
        "heldout": None
        if found.heldout is None
        else {
            "before": found.heldout.rms_before,
            "after": found.heldout.rms_after,
            "noise": found.heldout.noise_rms,
        },
    }


def _candidate(one: Candidate) -> dict[str, Any]:
    return {
        "effect": "+".join(sorted(one.effect.split("+"))),
        "probability": one.probability,
        "log_evidence": one.log_evidence,
        "refitted": one.refitted,
        "E": None if one.modulus is None else _modulus(one.modulus),
        "parameters": {
            name: {"value": own.value, "sd": own.sd, "interval": own.interval}
            for name, own in one.parameters.items()
        },
    }


def _modulus(one: Modulus) -> dict[str, Any]:
    return {
        "value": one.value,
        "sd": one.sd,
        "interval": [one.value - NINETY * one.sd, one.value + NINETY * one.sd],
    }


def of_problem(problem: ReducedCase) -> dict[str, Any]:
    """What the score takes from the linear problem."""
    linear = problem.linear()
    return {
        "chi2": linear.null.chi2,
        "chi2_usual": problem.count * MISFIT,
        "catalogue": sorted(gains_of(linear)),
    }


def rows_in(path: Path) -> list[dict[str, Any]]:
    """Answers so far; of two to the same case and alteration the first counts.

    Half a line, which a run that was killed leaves, is no answer.
    """
    known: dict[tuple[str, str], dict[str, Any]] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        with suppress(json.JSONDecodeError):
            row = json.loads(line)
            known.setdefault((row["case"], row["ablation"]), row)
    return list(known.values())


def keep_line(path: Path, row: dict[str, Any]) -> None:
    """Added at the end, on a line of its own whatever the last run left."""
    with path.open("a+") as file:
        file.seek(0)
        before = file.read()
        file.write(("" if before.endswith("\n") or not before else "\n") + json.dumps(row) + "\n")


def line_of(row: dict[str, Any]) -> str:
    """One answer in a line."""
    said = row.get("failure") or f"{' | '.join(row['verdict'])}, p {row['p']:.2g}"
    return f"{row['case']} {row['ablation']}: {said}, {row['cpu_s']:.0f} s CPU"
