"""The plain model of recordings on meshes that several tests share: each mesh is factorised once."""

from collections.abc import Sequence

from fem.estimation.compliance_fit import CompliantFit
from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.effect import Effect
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.procedure import case_model as of_solids
from fem.mismatch.selection.screening import LinearRound, screened
from fem.solid.linear_solid import Support, UnitModulusSolid

_SOLIDS: dict[tuple[int, float, Support], UnitModulusSolid] = {}
MOST_SOLIDS = 3


def case_model(
    case: MismatchCase, *, beyond_small_strain: bool = True
) -> tuple[CaseModel, list[CompliantFit]]:
    """As fem.mismatch.procedure has it, on solids that are kept."""
    supports = dict.fromkeys(grasp.support for grasp in case.grasps)
    solids = {support: kept_solid(case.mesh, case.poisson_ratio, support) for support in supports}
    return of_solids(case, solids=solids, beyond_small_strain=beyond_small_strain)


def kept_solid(mesh: FleshMesh, poisson_ratio: float, support: Support) -> UnitModulusSolid:
    """Factorised when it is first asked for; of the last MOST_SOLIDS."""
    key = id(mesh), poisson_ratio, support
    if key not in _SOLIDS:
        while len(_SOLIDS) >= MOST_SOLIDS:
            _SOLIDS.pop(next(iter(_SOLIDS)))
        _SOLIDS[key] = UnitModulusSolid.factorise(mesh, poisson_ratio=poisson_ratio, support=support)
    return _SOLIDS[key]


def screened_effects(model: CaseModel, effects: Sequence[Effect]) -> LinearRound:
    """The effects' linear signatures on all recordings."""
    return screened(model, [GraspEquations.of(model, grasp) for grasp in model.grasps], effects)
