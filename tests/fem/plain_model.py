"""The plain model of recordings on meshes that several tests share: each mesh is factorised once."""

from unittest import mock

from fem.elements.assembly import Stiffness, assemble
from fem.estimation.compliance_fit import CompliantFit
from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model import baseline
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.procedure import plain_forward_model as of_a_new_solid
from fem.solid.linear_solid import Support, UnitModulusSolid

_SOLIDS: dict[tuple[int, float, Support], UnitModulusSolid] = {}
MOST_SOLIDS = 3


def plain_forward_model(case: MismatchCase) -> tuple[ForwardModel, list[CompliantFit]]:
    """As fem.mismatch.procedure has it, on a solid that is kept."""
    parts: list[Stiffness] = []

    def factorised(mesh: FleshMesh, *, poisson_ratio: float, support: Support, **options) -> UnitModulusSolid:
        key = id(mesh), poisson_ratio, support
        if key not in _SOLIDS:
            parts[:] = parts or [assemble(mesh.nodes_mm, mesh.tets)]
            while len(_SOLIDS) >= MOST_SOLIDS:
                _SOLIDS.pop(next(iter(_SOLIDS)))
            _SOLIDS[key] = UnitModulusSolid.factorise(
                mesh, poisson_ratio=poisson_ratio, support=support, **{**options, "parts": parts[0]}
            )
        return _SOLIDS[key]

    with (
        mock.patch.object(baseline, "assemble"),
        mock.patch.object(baseline, "UnitModulusSolid", mock.Mock(factorise=factorised)),
    ):
        return of_a_new_solid(case)
