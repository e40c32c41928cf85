"""The plain model of a case at its 1/E, on which effects build, with values that are computed once."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock, RLock
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from fem.elements.assembly import Stiffness
from fem.estimation.grasp_model import GraspModel
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.relative_depth import relative_depth
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model.adjoint_basis import AdjointBasis
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, BalanceEquations, MarkerEquations
from fem.mismatch.model.plain_model import Fields, GraspResponse, PlainModel
from fem.mismatch.model.pulling_markers import LEAST_EVIDENCE, Pull
from fem.mismatch.model.warm_start import WarmStarts
from fem.parallel_map import parallel_map
from fem.solid.flesh_pieces import FleshPieces
from fem.solid.strain_field import FleshStrain

T = TypeVar("T")
SOFT = 1.5
"""Flesh counts as soft above this compliance ratio of flesh to gel."""
NEWTON_PER_MM3 = 9.81e-6
"""Specific weight of water: fruit barely float or sink in it."""


@dataclass(frozen=True)
class MemoTable:
    """Memoised values and a lock for each key: a thread waits while another computes the value it needs."""

    values: dict[object, Any] = field(default_factory=dict)
    locks: dict[object, RLock] = field(default_factory=dict)
    guard: Lock = field(default_factory=Lock)

    def memoised(self, key: object, compute: Callable[[], T]) -> T:
        """The value of `compute`, computed once for each key."""
        with self.guard:
            lock = self.locks.setdefault(key, RLock())
        with lock:
            if key not in self.values:
                self.values[key] = compute()
            kept: T = self.values[key]
            return kept


@dataclass(frozen=True, kw_only=True)
class CaseModel:
    """`compliance` is s = 1/E (1/MPa) of the plain model. `memo`: values computed for it once.

    `graded`: for each recording, the model about the prior's pit from which grading infers E; None if grading
    has no E for it; empty if it has none at all. `modulus_scale`: E from grading over E by this response. It
    places markers where they touched (fem.mismatch.model.touched_skin), may be that of a finer mesh
    (fem.mismatch.model.finer_mesh) and treats large deformation differently. `workers`: greatest number of
    threads. `path_share`: factor on the number of frames at which laws with a history are solved
    (fem.mismatch.model.stress_history). `beyond_small_strain`: False if the recordings' response includes
    finite strain already. `warm_starts`: those of the search that uses this model; None outside a search.
    """

    base: PlainModel
    compliance: float
    graded: tuple[GraspModel | None, ...] = field(default=(), repr=False, compare=False)
    modulus_scale: float = 1.0
    workers: int = 1
    path_share: float = 1.0
    beyond_small_strain: bool = True
    memo: MemoTable = field(default_factory=MemoTable, repr=False, compare=False)
    warm_starts: WarmStarts | None = field(default=None, repr=False, compare=False)

    def memoised(self, key: object, compute: Callable[[], T]) -> T:
        """The value of `compute`, computed once for each key, whichever thread needs it first."""
        return self.memo.memoised(key, compute)

    def each(self, call: Callable[[GraspResponse], T]) -> list[T]:
        """Results of `call` for each recording, in order; run in parallel."""
        return parallel_map(call, self.grasps, workers=self.workers)

    @property
    def case(self) -> MismatchCase:
        """The recordings of one fruit, with the assumptions about them."""
        return self.base.case

    @property
    def mesh(self) -> FleshMesh:
        """The flesh around the prior's pit."""
        return self.case.mesh

    @property
    def grasps(self) -> tuple[GraspResponse, ...]:
        """The recordings projected on the plain model."""
        return self.base.grasps

    @property
    def plain(self) -> Fields:
        """The plain model's displacement of every recording's markers, for E = 1 MPa."""
        return [recording.tracks.unit_displacement for recording in self.grasps]

    @property
    def pads(self) -> list[str]:
        """Names of all pads of the recordings."""
        return list(dict.fromkeys(pad for recording in self.grasps for pad in recording.pad_names))

    def marker_equations(self, recording: GraspResponse) -> MarkerEquations:
        """Equations of a recording's markers, with the case's standard deviation of marker scales.

        A frame of a thinned recording represents the frames left out; the design effect falls in proportion.
        """

        def compute() -> MarkerEquations:
            return MarkerEquations.of(
                recording,
                compliance=self.compliance,
                gel_scale_sd=self.case.budget.gel_scale_sd,
                design_effect=max(DESIGN_EFFECT * recording.kept, 1.0),
            )

        return self.memoised(("marker equations", recording.case.name, self.compliance), compute)

    def balance_equations(self, recording: GraspResponse) -> BalanceEquations | None:
        """Equilibrium of its forces; None unless two or more pads alone hold the fruit.

        The weight is a nuisance.
        """

        def compute() -> BalanceEquations | None:
            if recording.case.support != "free" or len(recording.links) < 2:
                return None
            weight_N = NEWTON_PER_MM3 * float(self.points.volume_mm3.sum())
            return BalanceEquations.of(recording, weight_N=weight_N, gels_stick=self.gels_stick)

        return self.memoised(("balance equations", recording.case.name), compute)

    def compliance_products(self, unit: Fields) -> tuple[float, float]:
        """u' W y and u' W u summed over recordings. u: displacement of the markers for E = 1 MPa; y: their
        measured displacement. The best 1/E is the first over the second.
        """
        along = plain = 0.0
        for k, recording in enumerate(self.grasps):
            tracks, equations = recording.tracks, self.marker_equations(recording)
            along += float((unit[k] * equations.weighed(tracks.position_mm - tracks.place_mm)).sum())
            plain += float((unit[k] * equations.weighed(unit[k])).sum())
        return along, plain

    @property
    def pull(self) -> Pull:
        """Markers at which gels pull at the skin, over all recordings of the fruit."""
        return self.memoised("pulling markers", lambda: Pull.of([each.case for each in self.grasps]))

    @property
    def gels_stick(self) -> bool:
        """Whether gels stick to the fruit, from all recordings: one alone may have few pulling markers."""
        return self.pull.evidence > LEAST_EVIDENCE

    @property
    def stiffness(self) -> csr_array:
        """K0 of the flesh, all nodes."""
        return next(iter(self.base.solids.values())).stiffness

    @property
    def parts(self) -> Stiffness:
        """The parts of K0 that Lame's constants multiply."""
        return next(iter(self.base.solids.values())).parts

    @property
    def poisson_ratio(self) -> float:
        """Of the case's flesh."""
        return self.case.poisson_ratio

    @property
    def points(self) -> FleshStrain:
        """The points in the flesh at which strains are evaluated."""
        return self.memoised("points", lambda: FleshStrain.of(self.mesh))

    @property
    def pieces(self) -> FleshPieces:
        """The flesh in pieces, for the forces of material laws."""
        return self.memoised("pieces", lambda: FleshPieces.of(self.points, workers=self.workers))

    @property
    def depth(self) -> Float[np.ndarray, "m 4"]:
        """Relative depth of the points: 0 at the skin, 1 at the pit (0 without one)."""
        points = self.points.point_mm
        return self.memoised(
            "depth", lambda: relative_depth(self.mesh, points.reshape(-1, 3)).reshape(points.shape[:2])
        )

    @property
    def adjoint_basis(self) -> AdjointBasis:
        """Sensitivity of the recordings to the modulus of every element."""
        return self.memoised(
            ("adjoint basis", self.compliance),
            lambda: AdjointBasis.of(self.base, self.points, compliance=self.compliance, workers=self.workers),
        )

    @cached_property
    def compliance_ratio(self) -> float:
        """Compliance ratio of flesh to gel, over SOFT; at least 1.

        The softer the flesh, the more steeply the traction falls at a patch's rim and the farther the skin
        moves, and the larger the residual of any model.
        """
        ratio = []
        for recording in self.grasps:
            tracks, touching = recording.tracks, recording.touching
            flesh = float((self.compliance * tracks.unit_displacement[touching]).std())
            gel = float(np.sqrt((tracks.gel_displacement_mm[touching] ** 2).sum(axis=1).mean()))
            if gel > 0:
                ratio.append(flesh / gel)
        return max(1.0, float(np.median(ratio)) / SOFT) if ratio else 1.0
