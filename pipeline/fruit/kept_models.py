"""Grasp models as the record that a stage file holds, and back."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float32
from numpy.typing import DTypeLike

from fem.estimation.grasp_model import GraspModel
from fem.fem_failure import FemFailure, FemProblem
from pipeline.batch.stage_record import StageRecord


class KeptFailure(StageRecord):
    """Why a grasp has no model."""

    problem: FemProblem
    detail: str


class KeptModel(StageRecord):
    """One GraspModel, its matrices in single precision: they are known to a thousandth.

    `triangle`: the lower one of its compliance, row by row, which `model` lacks.
    """

    model: GraspModel
    triangle: Float32[np.ndarray, " c"]


class KeptModels(StageRecord):
    """The stages "response-N": one of each grasp, in their order."""

    models: tuple[KeptModel | KeptFailure, ...]


def packed(models: Sequence[GraspModel | FemFailure]) -> KeptModels:
    """What is kept of them."""
    return KeptModels(
        models=tuple(
            KeptFailure(problem=model.problem, detail=model.detail)
            if isinstance(model, FemFailure)
            else _packed(model)
            for model in models
        )
    )


def unpacked(kept: KeptModels) -> list[GraspModel | FemFailure]:
    """What `packed` was given, to single precision."""
    return [
        FemFailure(of_grasp.problem, of_grasp.detail)
        if isinstance(of_grasp, KeptFailure)
        else _unpacked(of_grasp)
        for of_grasp in kept.models
    ]


def _packed(model: GraspModel) -> KeptModel:
    triangle = model.compliance[np.tril_indices(len(model.compliance))]
    bare = replace(_in(model, np.float32), compliance=np.zeros((0, 0)))
    return KeptModel(model=bare, triangle=triangle.astype(np.float32))


def _unpacked(kept: KeptModel) -> GraspModel:
    size = 3 * len(kept.model.place_mm)
    compliance = np.zeros((size, size))
    compliance[np.tril_indices(size)] = kept.triangle
    compliance += np.tril(compliance, -1).T
    return replace(_in(kept.model, np.float64), compliance=compliance)


def _in(model: GraspModel, precision: DTypeLike) -> GraspModel:
    """The model with what is computed frame by frame in this precision."""
    correction = model.displacement_correction
    return replace(
        model,
        sensitivity=replace(model.sensitivity, values=model.sensitivity.values.astype(precision)),
        displacement_correction=None if correction is None else correction.astype(precision),
    )
