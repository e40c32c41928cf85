"""Grasp models as the record that a stage file holds, and back."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from jaxtyping import Float, Float32
from pydantic import model_validator

from fem.estimation.grasp_model import GraspModel
from fem.estimation.sensitivity import Sensitivity
from fem.fem_failure import FemFailure, FemProblem
from pipeline.batch.stage_record import StageRecord


class KeptFailure(StageRecord):
    """Why a grasp has no model."""

    problem: FemProblem
    detail: str


class KeptModel(StageRecord):
    """One GraspModel; of its compliance, symmetric and known to a thousandth, the lower `triangle` row by row
    in single precision.
    """

    place_mm: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    triangle: Float32[np.ndarray, " c"]
    causes: tuple[str, ...]
    sensitivity: Float32[np.ndarray, "p f n 3"]
    discretisation: float
    fruit_moves: bool
    displacement_correction: Float32[np.ndarray, "t n 3"] | None
    small_strain_alone: str

    @model_validator(mode="after")
    def _of_its_markers(self) -> Self:
        """Raises ValueError where the triangle or the causes are those of another number of them."""
        size = 3 * len(self.place_mm)
        if len(self.triangle) != size * (size + 1) // 2 or len(self.causes) != len(self.sensitivity):
            raise ValueError(f"triangle or causes do not belong to {len(self.place_mm)} markers")
        return self

    @classmethod
    def of(cls, model: GraspModel) -> Self:
        """The model, its matrices in single precision."""
        correction = model.displacement_correction
        return cls(
            place_mm=model.place_mm,
            normal=model.normal,
            triangle=model.compliance[np.tril_indices(len(model.compliance))].astype(np.float32),
            causes=model.sensitivity.causes,
            sensitivity=model.sensitivity.values.astype(np.float32),
            discretisation=model.discretisation,
            fruit_moves=model.fruit_moves,
            displacement_correction=None if correction is None else correction.astype(np.float32),
            small_strain_alone=model.small_strain_alone,
        )

    def model(self) -> GraspModel:
        """What `of` was given, to single precision."""
        size = 3 * len(self.place_mm)
        compliance = np.zeros((size, size))
        compliance[np.tril_indices(size)] = self.triangle
        compliance += np.tril(compliance, -1).T
        correction = self.displacement_correction
        return GraspModel(
            place_mm=self.place_mm,
            normal=self.normal,
            compliance=compliance,
            sensitivity=Sensitivity(causes=self.causes, values=self.sensitivity.astype(float)),
            discretisation=self.discretisation,
            fruit_moves=self.fruit_moves,
            displacement_correction=None if correction is None else correction.astype(float),
            small_strain_alone=self.small_strain_alone,
        )


class KeptModels(StageRecord):
    """The stages "response-N": one of each grasp, in their order."""

    models: tuple[KeptModel | KeptFailure, ...]


def packed(models: Sequence[GraspModel | FemFailure]) -> KeptModels:
    """What is kept of them."""
    return KeptModels(
        models=tuple(
            KeptFailure(problem=model.problem, detail=model.detail)
            if isinstance(model, FemFailure)
            else KeptModel.of(model)
            for model in models
        )
    )


def unpacked(kept: KeptModels) -> list[GraspModel | FemFailure]:
    """What `packed` was given, to single precision."""
    return [
        FemFailure(model.problem, model.detail) if isinstance(model, KeptFailure) else model.model()
        for model in kept.models
    ]
