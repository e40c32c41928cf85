"""The modulus of one fruit from all its grasps, and with two or more of them the pit's place, if it matters.

The inference is linearised about a pit. If it places the pit far from there, the mesh is moved and the grasps
are computed again (Gauss-Newton). So slopes at the prior's pit do not decide about a pit far from it.

Each coordinate of the pit moves by its estimate relative to the prior, times the share of the prior variance
that the data remove (`PitPosterior.learnt`); the rest stays linear. If the fruit is symmetric about the
prior's pit, an offset acts to second order and its sign would be noise: then `learnt` is zero, and nothing
moves. A threshold on `learnt` would give meshes of one fruit two different results (docs/decisions/0005).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import GraspModel
from fem.estimation.joint_inference import FruitModulus, GraspEvidence, joint_modulus
from fem.estimation.modulus import ModulusEstimate, estimate_modulus
from fem.fem_failure import FemFailure
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.solid.moved_pit import with_pit_moved

FAR_MM, FAR_SIZE = 0.5, 0.05
"""Up to these the response is linear in the pit's offset and ln size to a hundredth of E."""
MOST_MOVES = 4
"""Most moves of the pit: each is a mesh and its solutions; without convergence by then there is a warning.
Set by hand."""


@dataclass(frozen=True, kw_only=True)
class FruitInference:
    """The fruit's modulus; each grasp's own modulus with the prior's pit, or why it has none.

    `models`: those of the grasps about the prior's pit, in their order; `final_models`: about the pit with
    which E is inferred. `moves`: how often the pit was moved in the mesh.
    """

    modulus: FruitModulus
    grasps: tuple[ModulusEstimate | FemFailure, ...]
    models: tuple[GraspModel | FemFailure, ...]
    final_models: tuple[GraspModel | FemFailure, ...]
    moves: int


def infer_modulus(
    histories: Sequence[GraspHistory],
    mesh: FleshMesh,
    respond: Callable[[FleshMesh], Sequence[GraspModel | FemFailure]],
    *,
    budget: ErrorBudget,
) -> FruitInference:
    """`respond` gives the model of every grasp on a mesh, or why it has none; called once for each mesh.

    The pit's place is inferred if two or more grasps give a modulus and the mesh has a pit. Raises an
    ExceptionGroup of every grasp's FemFailure if none gives one.
    """
    about_prior = tuple(respond(mesh))
    grasps = _tried(histories, about_prior, budget)
    evidence = _evidence(grasps)
    if not evidence:
        raise ExceptionGroup("no grasp gives a modulus", [g for g in grasps if isinstance(g, FemFailure)])
    joint = joint_modulus(evidence, budget=budget, infer_pit=len(evidence) > 1)
    at, moves, final, doubt = np.zeros(4), 0, about_prior, ""
    while joint.pit is not None:
        place = joint.pit.learnt * np.append(joint.pit.offset_mm, joint.pit.ln_size)
        if (np.abs(place - at) <= [FAR_MM, FAR_MM, FAR_MM, FAR_SIZE]).all():
            break
        if moves == MOST_MOVES:
            doubt = f"the pit's place did not converge in {moves} moves, so its error bar may be too small"
            break
        try:
            place, moved_mesh = _as_far_as_it_goes(mesh, at, place)
        except FemFailure as failure:
            doubt = f"drupe did not move the pit to its place from the grasps: {failure.detail}"
            break
        models = tuple(respond(moved_mesh))
        moved = _evidence(_tried(histories, models, budget))
        if len(moved) < len(evidence):
            doubt = "a grasp fails at the pit's place from the grasps, so this place is only a first estimate"
            break
        at, moves, final = place, moves + 1, models
        joint = joint_modulus(moved, budget=budget, infer_pit=True, pit_at=at)
    if doubt:
        joint = replace(joint, warnings=(*joint.warnings, doubt))
    return FruitInference(modulus=joint, grasps=grasps, models=about_prior, final_models=final, moves=moves)


def _as_far_as_it_goes(
    mesh: FleshMesh, at: Float[np.ndarray, "4"], place: Float[np.ndarray, "4"]
) -> tuple[Float[np.ndarray, "4"], FleshMesh]:
    """The mesh with the pit at `place`, or half or a quarter of the way there; raises INVERTED_ELEMENTS.

    A linear step may overshoot, even into the skin.
    """
    for share in (1.0, 0.5):
        try:
            return at + share * (place - at), with_pit_moved(mesh, at + share * (place - at))
        except FemFailure:
            continue
    return at + 0.25 * (place - at), with_pit_moved(mesh, at + 0.25 * (place - at))


def _tried(
    histories: Sequence[GraspHistory], models: Sequence[GraspModel | FemFailure], budget: ErrorBudget
) -> tuple[ModulusEstimate | FemFailure, ...]:
    """The modulus of each grasp, or why it has none."""
    tried: list[ModulusEstimate | FemFailure] = []
    for history, model in zip(histories, models, strict=True):
        if isinstance(model, FemFailure):
            tried.append(model)
            continue
        try:
            tried.append(estimate_modulus(history, model, budget=budget))
        except FemFailure as failure:
            tried.append(failure)
    return tuple(tried)


def _evidence(grasps: Sequence[ModulusEstimate | FemFailure]) -> list[GraspEvidence]:
    return [grasp.evidence for grasp in grasps if isinstance(grasp, ModulusEstimate)]
