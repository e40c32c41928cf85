"""Grasp models as the arrays and facts that a stage file holds, and back."""

from collections.abc import Sequence

import numpy as np

from fem.estimation.grasp_model import GraspModel
from fem.estimation.sensitivity import Sensitivity
from fem.fem_failure import FemFailure, FemProblem
from pipeline.batch.cache import Artifact


def packed(models: Sequence[GraspModel | FemFailure]) -> Artifact:
    """C is symmetric and known to a thousandth: one triangle of it in single precision."""
    arrays: dict[str, np.ndarray] = {}
    facts: list[dict[str, object]] = []
    for k, model in enumerate(models):
        if isinstance(model, FemFailure):
            facts.append({"problem": model.problem.value, "detail": model.detail})
            continue
        arrays |= {
            f"{k} place_mm": model.place_mm,
            f"{k} normal": model.normal,
            f"{k} compliance": model.compliance[np.tril_indices(len(model.compliance))].astype(np.float32),
            f"{k} sensitivity": model.sensitivity.values.astype(np.float32),
        }
        if model.displacement_correction is not None:
            arrays[f"{k} departure"] = model.displacement_correction.astype(np.float32)
        facts.append(
            {
                "causes": model.sensitivity.causes,
                "discretisation": model.discretisation,
                "fruit_moves": model.fruit_moves,
            }
        )
    return Artifact(arrays=arrays, facts={"models": facts})


def unpacked(artifact: Artifact) -> list[GraspModel | FemFailure]:
    """What `packed` was given, to single precision."""
    models: list[GraspModel | FemFailure] = []
    for k, facts in enumerate(artifact.facts["models"]):
        if "problem" in facts:
            models.append(FemFailure(FemProblem(facts["problem"]), facts["detail"]))
            continue
        size = 3 * len(artifact.arrays[f"{k} place_mm"])
        compliance = np.zeros((size, size))
        compliance[np.tril_indices(size)] = artifact.arrays[f"{k} compliance"]
        compliance += np.tril(compliance, -1).T
        displacement_correction = artifact.arrays.get(f"{k} departure")
        models.append(
            GraspModel(
                place_mm=artifact.arrays[f"{k} place_mm"],
                normal=artifact.arrays[f"{k} normal"],
                compliance=compliance,
                sensitivity=Sensitivity(
                    causes=tuple(facts["causes"]),
                    values=artifact.arrays[f"{k} sensitivity"].astype(float),
                ),
                discretisation=facts["discretisation"],
                fruit_moves=facts["fruit_moves"],
                displacement_correction=None
                if displacement_correction is None
                else displacement_correction.astype(float),
            )
        )
    return models
