"""The flesh of one fruit as finite elements, and what its modulus may be off by."""

import hashlib

import numpy as np
from jaxtyping import Float

from fem.mesh import FleshMesh, tetrahedralise
from fem.modulus_budget import ErrorBudget
from pipeline.cache import Artifact, cached, stage_key
from pipeline.config import Settings
from pipeline.outcome import FruitEnded, Outcome
from pipeline.shape import Pit, Shape
from pipeline.task import FruitTask
from recon.priors import PitPrior

OWN_PIT_OFFSET_SD_MM, OWN_PIT_SIZE_SD = 0.5, 0.03
"""Spread assumed for a pit that the user placed and said nothing more of."""


def poisson_ratio(settings: Settings, prior: PitPrior | None) -> tuple[float, str]:
    """Poisson's ratio of the flesh and who says so: the batch, else the category's prior."""
    if settings.poisson_ratio is not None:
        return settings.poisson_ratio, "batch.toml"
    if prior is not None:
        return prior.poisson_ratio, f"prior for {prior.category}"
    raise FruitEnded(Outcome.NO_POISSON_RATIO, settings.category)


def flesh_mesh(task: FruitTask, shape: Shape, pit: Pit, touched_mm: Float[np.ndarray, "p 3"]) -> FleshMesh:
    """T10 elements of the flesh, fine under the pads; kept until shape, pit, pads or settings change."""
    sizes = task.settings.mesh
    arrays = (shape.vertices, shape.faces, pit.vertices, pit.faces, touched_mm)
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()
    key = stage_key("flesh", files=[], settings=[sizes.model_dump(), digest], rooms=("fem",))

    def compute() -> Artifact:
        mesh = tetrahedralise(
            shape.vertices,
            shape.faces,
            pit.vertices,
            pit.faces,
            edge_mm=sizes.edge_mm,
            refine_at_mm=touched_mm,
            refine_edge_mm=sizes.pad_edge_mm,
        )
        return Artifact(
            arrays={
                "nodes_mm": mesh.nodes_mm,
                "tets": mesh.tets,
                "outer_faces": mesh.outer_faces,
                "pit_nodes": mesh.pit_nodes,
            }
        )

    return FleshMesh(**cached(task.results.cache, "flesh", key, compute).arrays)


def error_budget(task: FruitTask, shape: Shape) -> ErrorBudget:
    """Spread of pit prior and surface, from the batch's settings, else the prior's, else assumed."""
    own, prior = task.settings.pit, task.prior
    offset = own.offset_sd_mm or (prior.offset_sd_mm if prior else OWN_PIT_OFFSET_SD_MM)
    size = own.size_sd or (prior.size_sd if prior else OWN_PIT_SIZE_SD)
    if shape.record.surface_sd_mm is None:
        return ErrorBudget(pit_offset_sd_mm=offset, pit_size_sd=size)
    return ErrorBudget(pit_offset_sd_mm=offset, pit_size_sd=size, surface_sd_mm=shape.record.surface_sd_mm)
