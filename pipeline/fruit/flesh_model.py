"""The flesh of one fruit as finite elements, and the error budget of its modulus."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fem.estimation.error_budget import ErrorBudget
from fem.mesh.flesh_mesh import FleshMesh, refined, tetrahedralise
from fem.mismatch.effect_spec import Correction
from pipeline.batch.cache import StageRecord, cached, content_hash, stage_key
from pipeline.batch.confirmed_effects import pit_found
from pipeline.batch.named_priors import NAME as REFERENCE
from pipeline.batch.settings import Settings
from pipeline.batch.task import FruitTask
from pipeline.fruit.fruit_shape import FruitPit, FruitShape
from recon.pit.priors import PitPrior
from tactile.readers.recording import Recording

FINER_DOF, MOST_DOF = 30_000, 240_000
"""Degrees of freedom of the finer mesh, for each grasp and at most. Set by hand on an external nectarine of
0.18 MPa without noise: 60,000 for four grasps leave residuals of 1.9 to 2.1 um, 120,000 leave 1.1 to 1.6, and
180,000 leave 0.9 to 1.5. Factorisation takes 9 s of CPU with 120,000, and 14 s with 180,000. The limit bounds
memory: from nine grasps on, elements are coarser."""
WORTH = 1.3
"""Least ratio of degrees of freedom to those of grading's mesh for which a finer one is made: three grasps or
more. Set by hand."""


class KeptFlesh(StageRecord):
    """The stage "flesh"."""

    mesh: FleshMesh


def poisson_ratio(settings: Settings, prior: PitPrior | None) -> tuple[float, float, str]:
    """Poisson's ratio of the flesh, its standard deviation, and its source: the batch, else the prior.

    A ratio that a batch states without a spread counts as exact; one that was found in recordings precedes
    both.
    """
    for effect in settings.mismatch:
        if effect.spec.correction is Correction.POISSON_RATIO:
            return effect.number("nu"), effect.spread("nu"), "found by drupe explain"
    if settings.poisson_ratio is not None:
        return settings.poisson_ratio, settings.poisson_ratio_sd or 0.0, "batch.toml"
    if prior is not None and prior.poisson_ratio is not None:
        sd = settings.poisson_ratio_sd
        return (
            prior.poisson_ratio,
            prior.poisson_ratio_sd if sd is None else sd,
            f"{'' if prior.category == REFERENCE else 'prior for '}{prior.category}",
        )
    raise ValueError("a batch was opened without Poisson's ratio")


def flesh_mesh(task: FruitTask, pit: FruitPit, touched_mm: Float[np.ndarray, "p 3"]) -> FleshMesh:
    """T10 elements of the flesh, fine under the pads; cached until shape, pit, pads or settings change.

    The flesh is solid if there is no pit.
    """
    sizes = task.settings.mesh
    digest = content_hash(*pit.skin, pit.vertices, pit.faces, touched_mm)
    key = stage_key("flesh", files=[], settings=[sizes.model_dump(), digest], rooms=("pipeline", "fem"))

    def compute() -> KeptFlesh:
        mesh = tetrahedralise(
            *pit.skin,
            *((pit.vertices, pit.faces) if len(pit.faces) else (None, None)),
            edge_mm=sizes.edge_mm,
            refine_at_mm=touched_mm,
            refine_edge_mm=sizes.pad_edge_mm,
        )
        return KeptFlesh(mesh=mesh)

    return cached(task.results.cache, "flesh", key, compute, record=KeptFlesh).mesh


def finer_flesh(
    task: FruitTask, pit: FruitPit, mesh: FleshMesh, touched_mm: Float[np.ndarray, "p 3"], *, grasps: int
) -> FleshMesh | None:
    """The same flesh with smaller elements under the pads, for the plain response of the mismatch finder.

    None if it would hardly be finer. Raises FemFailure as fem.mesh.flesh_mesh.refined.
    """
    dof_limit = min(FINER_DOF * grasps, MOST_DOF)
    if dof_limit < WORTH * mesh.nodes_mm.size:
        return None
    return refined(
        mesh,
        *pit.skin,
        *((pit.vertices, pit.faces) if len(pit.faces) else (None, None)),
        edge_mm=task.settings.mesh.edge_mm,
        refine_at_mm=touched_mm,
        refine_edge_mm=task.settings.mesh.pad_edge_mm,
        dof_limit=dof_limit,
    )


def error_budget(task: FruitTask, shape: FruitShape, recordings: Sequence[Recording] = ()) -> ErrorBudget:
    """Standard deviations from the batch's settings, else the largest of the recordings' or the prior's, else
    the budget's defaults.
    """
    pit, prior, sensor = task.settings.pit, task.prior, task.settings.sensor
    placed = pit_found(task.settings.mismatch)
    known = {
        "gel_scale_sd": sensor.gel_scale_sd if sensor else None,
        "force_scale_sd": sensor.force_scale_sd if sensor else None,
        "pose_sd_mm": (sensor.pose_sd_mm if sensor else None)
        or max((recording.pose_sd_mm or ErrorBudget.pose_sd_mm for recording in recordings), default=None),
        "pit_offset_sd_mm": placed.offset_sd_mm
        or pit.offset_sd_mm
        or (prior.offset_sd_mm if prior else None),
        "pit_size_sd": placed.size_sd or pit.size_sd or (prior.size_sd if prior else None),
        "surface_sd_mm": shape.record.surface_sd_mm,
        "poisson_ratio_sd": poisson_ratio(task.settings, prior)[1],
    }
    return ErrorBudget(**{name: value for name, value in known.items() if value is not None})
