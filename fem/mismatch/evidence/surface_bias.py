"""Errors in variables: bias of the products of fields with the data by the error of the scanned surface.

An error of the surface changes the response c by dc, and the signature phi of another law of the flesh, which
depends on c, by dphi. Both changes have the same waves. So phi . W y with y = data - s c has a nonzero mean
without any effect,

    n = E[dphi . W (-s dc)],

as it has by the noise of the forces (fem.mismatch.model.force_noise). Uncorrected, a smooth error of
0.1 mm looks like a skin of 0.3 mm. n is estimated from one drawn error, for which all patterns and the
laws that are linear in the flesh's stiffness are solved again. n is of second order: the opposite error gives
the same n. The product for the error that is there differs from n, by SPREAD n: so much of a signature's
amount is a known error of the model (fem.mismatch.evidence.model_error).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import assemble
from fem.estimation.sensitivity import mean_normal
from fem.mismatch.effect import Effect, Signature
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import ObservationDelta
from fem.mismatch.model.plain_model import GraspResponse, PlainModel
from fem.solid.linear_solid import Support, UnitModulusSolid
from fem.solid.shape_derivative import with_surface_error

SEED = 0
"""Seed of the drawn error; any number does."""
STEP = 0.01
"""The drawn error as a share of the surface's. dphi and dc are linear in it, and n is scaled by its square; a
small error inverts no element."""
SPREAD = 0.5
"""Standard deviation of the product over n. Between drawn errors it is 0.25 on four grasps (two bodies, four
draws each) and 0.5 on one (eight draws); a drawn and the true one differ by 1.4 times that."""


@dataclass(frozen=True, kw_only=True)
class SurfaceBias:
    """`products`: n of each recording and column. `sd`: by column, the standard deviation of the apparent
    amount that is left when n is subtracted.
    """

    products: Float[np.ndarray, "g c"]
    sd: Mapping[int, float] = field(default_factory=dict)


def surface_bias(
    model: CaseModel,
    recorded: Sequence[GraspEquations],
    signatures: Sequence[tuple[Effect, Signature, tuple[int, ...]]],
    *,
    columns: int,
) -> SurfaceBias:
    """n (zero where a column is not a signature of an effect linear in the stiffness), and its spread.

    `signatures`: with the numbers of their columns, which count from one. Column 0 is the plain model's.
    Raises FemFailure (INVERTED_ELEMENTS) where an element is nearly folded already.
    """
    products = np.zeros((len(recorded), columns))
    linear = [
        (effect, signature, numbers, before)
        for effect, signature, numbers in signatures
        if (before := effect.at_small_strain(model)) is not None
    ]
    if not linear:
        return SurfaceBias(products=products)
    drawn = with_drawn_surface(model)
    weighed = []
    for equations, recording in zip(recorded, drawn.grasps, strict=True):
        change = recording.tracks.unit_displacement - equations.recording.tracks.unit_displacement
        weighed.append(equations.rows([ObservationDelta(markers=-model.compliance * change)])[1][0])
    sd = dict[int, float]()
    for effect, signature, (number,), before in linear:
        after = effect.at_small_strain(drawn)
        assert after is not None, "the same effect"
        information = 0.0
        for k, equations in enumerate(recorded):
            change = equations.flat(ObservationDelta(markers=after[k] - before[k]))
            products[k, number] = change @ weighed[k] / STEP**2
            (plain,), (heavy,) = equations.rows([signature.columns[0].fields[k]])
            information += float(heavy @ plain)
        sd[number] = SPREAD * abs(float(products[:, number].sum())) / information
    return SurfaceBias(products=products, sd=sd)


class NearbySolid(UnitModulusSolid):
    """A solid on a slightly moved mesh, solved with the factor of the original mesh.

    With the stiffness K0 + dK its displacement is U - K0^-1 dK U, with U on the original mesh: exact to first
    order in the nodes' motion.
    """

    def displacement(self, nodal_force_N: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """As UnitModulusSolid.displacement."""
        before = super().displacement(nodal_force_N)
        held_N = (self.stiffness @ before.reshape(len(before), -1).T).T.reshape(before.shape)
        return np.asarray(before + super().displacement(nodal_force_N - held_N))


def _nearby(solid: UnitModulusSolid, **moved: Any) -> NearbySolid:
    """The solid with the attributes of the moved mesh."""
    return NearbySolid(**{field.name: getattr(solid, field.name) for field in fields(solid)} | moved)


def with_drawn_surface(model: CaseModel) -> CaseModel:
    """The model of the same recordings on a mesh with a drawn surface error, STEP times the budget's.

    Markers keep their places on their elements. Raises FemFailure (INVERTED_ELEMENTS).
    """
    base, case = model.base, model.case
    pads = [
        (link.place.point_mm, mean_normal(link.place.normal))
        for recording in base.grasps
        for link in recording.links
    ]
    variances = [case.budget.surface_under_pads_mm(grasp.history) ** 2 for grasp in case.grasps]
    sd_mm = float(np.sqrt(np.mean(np.concatenate(variances))))
    mesh = with_surface_error(case.mesh, pads, sd_mm=STEP * sd_mm, rng=np.random.default_rng(SEED))
    parts = assemble(mesh.nodes_mm, mesh.tets)
    stiffness = parts.for_unit_modulus(poisson_ratio=model.poisson_ratio)
    solids: dict[Support, UnitModulusSolid] = {
        support: _nearby(solid, mesh=mesh, parts=parts, stiffness=stiffness)
        for support, solid in base.solids.items()
    }

    def again(recording: GraspResponse) -> GraspResponse:
        solid = solids[recording.case.support]
        moved = solid.displacement(recording.loads(recording.patterns))
        response = recording.at_markers(moved)
        tracks = replace(recording.tracks, unit_displacement=recording.whole(response))
        return replace(recording, solid=solid, moved=moved, response=response, tracks=tracks)

    moved_base = PlainModel(
        case=replace(case, mesh=mesh, finer_mesh=None), solids=solids, grasps=tuple(model.each(again))
    )
    return CaseModel(
        base=moved_base, compliance=model.compliance, workers=model.workers, beyond_small_strain=False
    )
