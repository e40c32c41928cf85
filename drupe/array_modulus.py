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
"""Standard deviations on either side of the mean that hold 90 % of a Gaussian."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerResidual:
    """Misfit of k markers of a pad at full load: places on the skin (k, 3) and residuals (k,), mm.

    The mesh's frame. Positive: the recorded skin went farther into the fruit than the model's.
    """

    name: str
    place_mm: Float[np.ndarray, "k 3"]
    residual_mm: Float[np.ndarray, " k"]


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
    solid body, or "prior" for the usual pit of the category. `nu`: Poisson's ratio of the flesh, no unit,
    taken as exact unless `settings` has "poisson_ratio_sd"; None: that of the category. `category`:
    "nectarine" or another; None: nothing is assumed of the fruit, and E from 0.0005 to 60 MPa is accepted.
    `settings`: further keys of batch.toml (docs/formats.md), for example {"mesh": {"edge_mm": 8.0}}; paths in
    it are absolute. `report` receives the name of each stage as it begins.

    Takes about a minute on one core. Raises DrupeError where the input gives no E.
    """
    log = StageLog(report)
    given = array_batch(mesh, recordings, pit=pit, nu=nu, category=category, settings=settings)
    with given as root, threadpool_limits(1):
        fruit, inference = measured_fruit(array_task(root), log)
        patches = patch_residuals(fruit.placed, inference.grasps)
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
            MarkerResidual(name=patch.name, place_mm=patch.places_mm, residual_mm=patch.residual_um / 1e3)
            for patch in patches
        ),
    )
