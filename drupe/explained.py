"""Physics that the model misses in one fruit's recordings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drupe.array_batch import FRUIT_ID, Pit, Surface, array_batch, silent
from drupe.refusal import DrupeError, refusals
from pipeline.diagnosis.explaining import ExplainOutputs, NotExplained
from pipeline.diagnosis.explaining import explain as explained
from reports.effect_words import explain_verdict
from reports.words import NO_BREAK
from tactile.readers.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplainedMismatch:
    """The answer of `drupe explain` on a fruit's recordings.

    `verdict`: "none", the name of the effect, several indistinguishable effects, or "unknown". `sentence`:
    the verdict in words. `p_value`: probability of a misfit at least this large without a mismatch. `E_MPa`,
    `E_sd_MPa`: with the effect; `E_without_MPa`, `E_without_sd_MPa`: without it. `candidates`: a row per
    explanation, most probable first. `heldout`: normalised residuals on held-out recordings, without the
    effect (`heldout_rms_before`), with it (`heldout_rms_after`) and of noise alone (`noise_rms`). It is None
    for one recording: nothing then confirms an effect. `next_grasp`: what to record next, if an answer is
    open. `answer`: the JSON of `drupe explain` (docs/formats.md).
    """

    verdict: tuple[str, ...]
    sentence: str
    p_value: float
    E_MPa: float
    E_sd_MPa: float
    E_without_MPa: float
    E_without_sd_MPa: float
    candidates: pd.DataFrame
    heldout: Mapping[str, float] | None
    next_grasp: str | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    answer: Mapping[str, Any]


def explain(
    mesh: Surface,
    recordings: Recording | Sequence[Recording],
    *,
    pit: Pit,
    nu: float | None,
    category: str | None = None,
    settings: Mapping[str, Any] | None = None,
    jobs: int = 1,
    report: Callable[[str], None] = silent,
) -> ExplainedMismatch:
    """Physics that the model misses in a fruit's recordings. Arguments and errors are those of `modulus`.

    The test on held-out recordings needs at least two recordings. `jobs`: threads. Takes minutes.
    """
    given = array_batch(mesh, recordings, pit=pit, nu=nu, category=category, settings=settings)
    with given as root:
        return _explained(root, FRUIT_ID, None, jobs, report)


def explain_fruit(
    batch: str | Path,
    fruit_id: str,
    *,
    out: str | Path | None = None,
    jobs: int = 1,
    report: Callable[[str], None] = silent,
) -> ExplainedMismatch:
    """Physics that the model misses in a fruit of a batch on disk, with the batch's settings.

    `out`: the results of `drupe grade`, BATCH/results by default; drupe adds the answer there. Raises
    DrupeError if the batch, the fruit or its recordings are unusable.
    """
    with refusals():
        return _explained(Path(batch), fruit_id, None if out is None else Path(out), jobs, report)


def _explained(
    root: Path, fruit_id: str, out: Path | None, jobs: int, report: Callable[[str], None]
) -> ExplainedMismatch:
    wanted = ExplainOutputs(out=out)
    try:
        entry = explained(root, fruit_id=fruit_id, wanted=wanted, report=report, jobs=jobs)
    except NotExplained as failure:
        raise DrupeError(str(failure)) from failure
    columns = ["effect", "probability", "log_evidence", "E_MPa", "E_sd_MPa"]
    rows = [
        (
            hypothesis.effect,
            hypothesis.probability,
            hypothesis.log_evidence,
            np.nan if hypothesis.modulus is None else hypothesis.modulus.value,
            np.nan if hypothesis.modulus is None else hypothesis.modulus.sd,
        )
        for hypothesis in entry.ranking
    ]
    answer = entry.as_json()
    return ExplainedMismatch(
        verdict=entry.verdict,
        sentence=explain_verdict(entry).replace(NO_BREAK, " "),
        p_value=float(entry.p_value),
        E_MPa=float(entry.after.value),
        E_sd_MPa=float(entry.after.sd),
        E_without_MPa=float(entry.before.value),
        E_without_sd_MPa=float(entry.before.sd),
        candidates=pd.DataFrame(rows, columns=columns).astype(
            {
                "effect": "string",
                "probability": float,
                "log_evidence": float,
                "E_MPa": float,
                "E_sd_MPa": float,
            }
        ),
        heldout=None if entry.heldout is None else answer["fit"],
        next_grasp=answer["next_grasp"],
        notes=entry.notes,
        doubts=entry.doubts,
        answer=answer,
    )
