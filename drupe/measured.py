"""E of one fruit, and what the model misses of it, from arrays."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from drupe.array_batch import FRUIT_ID, Pit, Surface, array_batch, array_task
from drupe.refusal import refusals
from pipeline.diagnosis.explaining import ExplainOutputs
from pipeline.diagnosis.explaining import explain as explained
from pipeline.fruit.placed_grasp import patch_residuals
from pipeline.fruit.stage_log import StageLog
from pipeline.fruit.stages import measured_fruit
from reports.effect_words import explain_verdict
from reports.words import NO_BREAK
from tactile.io.recording import Recording

NINETY = NormalDist().inv_cdf(0.95)
"""Standard deviations on either side of the mean that hold 90 % of a Gaussian."""


def silent(_: str) -> None:
    """Reports no progress."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerResidual:
    """Misfit of k markers of a pad at full load: places on the skin (k, 3) and residuals (k,), mm.

    The mesh's frame. Positive: the recorded skin went farther into the fruit than the model's.
    """

    name: str
    place_mm: np.ndarray
    residual_mm: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredModulus:
    """Young's modulus of the flesh of one fruit, from all its recordings together.

    `E_sd_MPa`: standard deviation without the common scale of force and gel stiffness, whose part is
    `E_scale_sd_MPa`. `interval_90_MPa` includes both. `parts_sd_MPa`: causes of the error bar. `recordings`:
    a row per recording with its own E, or why it is not used. `warnings`: sentences; `doubts`: those of them
    that name contradictions in the input. `residuals`: an entry per recording and pad.
    """

    E_MPa: float
    E_sd_MPa: float
    E_scale_sd_MPa: float
    parts_sd_MPa: Mapping[str, float]
    recordings: pd.DataFrame
    warnings: tuple[str, ...]
    doubts: tuple[str, ...]
    residuals: tuple[MarkerResidual, ...]

    @property
    def interval_90_MPa(self) -> tuple[float, float]:
        """The interval that contains E with a probability of 90 %, clipped at zero."""
        half = NINETY * float(np.hypot(self.E_sd_MPa, self.E_scale_sd_MPa))
        return max(self.E_MPa - half, 0.0), self.E_MPa + half


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplainedMismatch:
    """What the model misses in a fruit's recordings, as `drupe explain` says it.

    `verdict`: "none", the name of the effect, several that look the same, or "unknown". `sentence`: the
    verdict in words. `p_value`: probability of so large a misfit without a mismatch. `E_MPa`, `E_sd_MPa`:
    with the effect; `E_without_MPa`, `E_without_sd_MPa`: without one. `candidates`: a row per explanation,
    likeliest first. `answer`: everything, as docs/formats.md defines the JSON of `drupe explain`.
    """

    verdict: tuple[str, ...]
    sentence: str
    p_value: float
    E_MPa: float
    E_sd_MPa: float
    E_without_MPa: float
    E_without_sd_MPa: float
    candidates: pd.DataFrame
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    answer: Mapping[str, Any]


def modulus(
    mesh: Surface,
    recordings: Sequence[Recording],
    *,
    pit: Pit,
    nu: float | None,
    category: str | None = None,
    settings: Mapping[str, Any] | None = None,
    report: Callable[[str], None] = silent,
) -> MeasuredModulus:
    """E of a fruit, as `drupe grade` computes it from the same mesh and recordings.

    `mesh`: vertices (n, 3) in mm and triangles (m, 3) of the closed skin, outward normals. `recordings`: from
    `recording` or `read_recording`, all of this fruit. `pit`: the pit's mesh in the same frame, "none" for a
    solid body, or "prior" for the usual pit of the category. `nu`: Poisson's ratio of the flesh, no unit;
    None: that of the category. `category`: "nectarine" or another; None: nothing is assumed of the fruit, and
    E from 0.0005 to 60 MPa is accepted. `settings`: further keys of batch.toml (docs/formats.md), for example
    {"mesh": {"edge_mm": 8.0}}. `report` receives the name of each stage as it begins.

    Takes about a minute on one core. Raises DrupeError where the input gives no E.
    """
    log = StageLog(report)
    given = array_batch(mesh, recordings, pit=pit, nu=nu, category=category, settings=settings)
    with given as root, threadpool_limits(1):
        fruit, found = measured_fruit(array_task(root), log)
        patches = patch_residuals(fruit.placed, found.grasps)
    held = log.facts.modulus
    assert held is not None  # set where measured_fruit returns
    return MeasuredModulus(
        E_MPa=held.E_MPa,
        E_sd_MPa=held.E_sd_MPa,
        E_scale_sd_MPa=held.scale_sd_MPa,
        parts_sd_MPa=held.parts_sd_MPa,
        recordings=pd.DataFrame(
            {
                "recording": [grasp.grasp for grasp in log.facts.grasps],
                "E_MPa": [grasp.E_MPa for grasp in log.facts.grasps],
                "E_sd_MPa": [grasp.E_sd_MPa for grasp in log.facts.grasps],
                "failure": [grasp.failure for grasp in log.facts.grasps],
            }
        ).astype({"recording": "string", "E_MPa": float, "E_sd_MPa": float, "failure": "string"}),
        warnings=tuple(dict.fromkeys(log.warnings)),
        doubts=log.facts.doubts,
        residuals=tuple(
            MarkerResidual(name=one.name, place_mm=one.places_mm, residual_mm=one.residual_um / 1e3)
            for one in patches
        ),
    )


def explain(
    mesh: Surface,
    recordings: Sequence[Recording],
    *,
    pit: Pit,
    nu: float | None,
    category: str | None = None,
    settings: Mapping[str, Any] | None = None,
    jobs: int = 1,
    report: Callable[[str], None] = silent,
) -> ExplainedMismatch:
    """Physics that the model misses in a fruit's recordings. Arguments and errors are those of `modulus`.

    Two recordings or more are needed to test an answer on data that the fit did not see. `jobs`: threads.
    Takes minutes.
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
    """The same for a fruit of a batch on disk; results go to `out`, the folder of `drupe grade` by default."""
    with refusals():
        return _explained(Path(batch), fruit_id, None if out is None else Path(out), jobs, report)


def _explained(
    root: Path, fruit_id: str, out: Path | None, jobs: int, report: Callable[[str], None]
) -> ExplainedMismatch:
    wanted = ExplainOutputs(out=out)
    entry = explained(root, fruit_id=fruit_id, wanted=wanted, report=report, jobs=jobs)
    columns = ["effect", "probability", "log_evidence", "E_MPa", "E_sd_MPa"]
    rows = [
        (
            one.effect,
            one.probability,
            one.log_evidence,
            np.nan if one.E_MPa is None else one.E_MPa.value,
            np.nan if one.E_MPa is None else one.E_MPa.sd,
        )
        for one in entry.ranking
    ]
    kinds = {"effect": "string", **dict.fromkeys(columns[1:], float)}
    return ExplainedMismatch(
        verdict=entry.verdict,
        sentence=explain_verdict(entry).replace(NO_BREAK, " "),
        p_value=float(entry.p_value),
        E_MPa=float(entry.E_MPa.after.value),
        E_sd_MPa=float(entry.E_MPa.after.sd),
        E_without_MPa=float(entry.E_MPa.before.value),
        E_without_sd_MPa=float(entry.E_MPa.before.sd),
        candidates=pd.DataFrame(rows, columns=columns).astype(kinds),
        notes=entry.notes,
        doubts=entry.doubts,
        answer=entry.as_json(),
    )
