"""E of one fruit from arrays."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from drupe.array_batch import Pit, Surface, array_batch, array_task, silent
from pipeline.fruit.placed_grasp import patch_residuals
from pipeline.fruit.stage_log import StageLog
from pipeline.fruit.stages import measured_fruit
from tactile.readers.recording import Recording

NINETY = NormalDist().inv_cdf(0.95)
"""Half-width of a Gaussian's central 90 % interval, in standard deviations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerResidual:
    """Residuals (k,) of a pad's k markers at full load, and their places (k, 3) on the skin, mm, mesh frame.

    Positive: the recorded skin moved farther into the fruit than the model's.
    """

    name: str
    place_mm: Float[np.ndarray, "k 3"]
    residual_mm: Float[np.ndarray, " k"]


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredModulus:
    """Young's modulus of the flesh of one fruit, from all its recordings together.

    `E_sd_MPa`: standard deviation without the common scale of force and gel stiffness. `E_scale_sd_MPa`: the
    standard deviation from that scale. `interval_90_MPa` includes both. `parts_sd_MPa`: causes of the error
    bar. `recordings`: a row per recording with its E, or why drupe does not use it. `warnings`: sentences.
    `doubts`: warnings that name contradictions in the input. `residuals`: an entry per recording and pad.
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


def modulus(
    mesh: Surface,
    recordings: Recording | Sequence[Recording],
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
    solid body, or "prior" for the category's prior. `nu`: Poisson's ratio of the flesh, exact unless
    `settings` has "poisson_ratio_sd"; None: the category's. `category`: "nectarine" or another; None: the
    widest plausible ranges, E from 0.0005 to 60 MPa. `settings`: further keys of batch.toml
    (docs/formats.md), for example {"mesh": {"edge_mm": 8.0}}; paths in it are absolute. `report` receives the
    name of each stage at its start.

    Takes about a minute on one core. Raises DrupeError if the input is unusable or gives no E.
    """
    log = StageLog(report)
    given = array_batch(mesh, recordings, pit=pit, nu=nu, category=category, settings=settings)
    with given as root, threadpool_limits(1):
        fruit, inference = measured_fruit(array_task(root), log)
        patches = patch_residuals(fruit.placed, inference.grasps)
    held = log.facts.modulus
    assert held is not None  # measured_fruit raises or sets it
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
            MarkerResidual(name=patch.name, place_mm=patch.places_mm, residual_mm=patch.residual_um / 1e3)
            for patch in patches
        ),
    )
