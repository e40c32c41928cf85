"""What effects build their signatures from: the plain model's fit, and strains of the whole flesh."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock, RLock
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fem.mismatch.model.adjoint_basis import AdjointBasis
from fem.mismatch.model.baseline import Baseline, GraspResponse
from fem.mismatch.model.warm_start import WarmStarts
from fem.parallel_map import parallel_map
from fem.solid.strain_field import FleshStrain

T = TypeVar("T")
SOFT = 1.5
"""How many times farther flesh than gel gives way from where on it counts as soft."""


@dataclass(frozen=True)
class Memory:
    """Values by key. A lock for each: threads that want one wait for the one that computes it."""

    values: dict[object, Any] = field(default_factory=dict)
    locks: dict[object, RLock] = field(default_factory=dict)
    guard: Lock = field(default_factory=Lock)

    def kept(self, key: object, compute: Callable[[], T]) -> T:
        """What `compute` gives, computed once for each key."""
        with self.guard:
            lock = self.locks.setdefault(key, RLock())
        with lock:
            if key not in self.values:
                self.values[key] = compute()
            found: T = self.values[key]
            return found


@dataclass(frozen=True, kw_only=True)
class ForwardModel:
    """`compliance` is s = 1/E (1/MPa) of the plain model. `memory`: what has been computed for it once.

    `workers`: how many threads may work on it at once. `warm_starts`: of the search that this ground is used
    in, None outside of one.
    """

    base: Baseline
    compliance: float
    workers: int = 1
    memory: Memory = field(default_factory=Memory, repr=False, compare=False)
    warm_starts: WarmStarts | None = field(default=None, repr=False, compare=False)

    def found_before(self, key: object) -> tuple[Any, ...]:
        """What the search has found under a key, newest first; nothing outside of a search."""
        return () if self.warm_starts is None else self.warm_starts.found.get(key, ())

    def keep_found(self, key: object, found: tuple[Any, ...]) -> None:
        """For the search's next calls, in the place of what was there; forgotten outside of a search."""
        if self.warm_starts is not None:
            self.warm_starts.found[key] = found

    def kept(self, key: object, compute: Callable[[], T]) -> T:
        """What `compute` gives, computed once for each key, whichever thread asks first."""
        return self.memory.kept(key, compute)

    def each(self, call: Callable[[GraspResponse], T]) -> list[T]:
        """`call` of every recording, in their order, side by side."""
        return parallel_map(call, self.base.grasps, workers=self.workers)

    @property
    def stiffness(self) -> csr_array:
        """K0 of the flesh, all nodes."""
        return next(iter(self.base.solids.values())).stiffness

    @property
    def poisson_ratio(self) -> float:
        """As the case assumes it."""
        return self.base.case.poisson_ratio

    @property
    def points(self) -> FleshStrain:
        """The points in the flesh at which strains are taken."""
        return self.kept("points", lambda: FleshStrain.of(self.base.mesh))

    @property
    def depth(self) -> Float[np.ndarray, "m 4"]:
        """Relative depth of the points: 0 at the skin, 1 at the pit (0 without one)."""
        return self.kept("depth", self._depth)

    def _depth(self) -> Float[np.ndarray, "m 4"]:
        mesh = self.base.mesh
        to_skin = cKDTree(mesh.nodes_mm[mesh.outer_nodes]).query(self.points.point_mm)[0]
        if not len(mesh.pit_nodes):
            return np.zeros_like(to_skin)
        to_pit = cKDTree(mesh.nodes_mm[mesh.pit_nodes]).query(self.points.point_mm)[0]
        return np.asarray(to_skin / (to_skin + to_pit))

    @property
    def sight(self) -> AdjointBasis:
        """What the recordings see of every piece of flesh."""
        return self.kept(
            ("sight", self.compliance),
            lambda: AdjointBasis.of(self.base, self.points, compliance=self.compliance, workers=self.workers),
        )

    @cached_property
    def compliance_ratio(self) -> float:
        """How many times farther the flesh gives way than the gel, over SOFT; at least 1.

        The softer flesh is, the more steeply the traction falls at a patch's rim and the farther the skin
        moves, and the more a model leaves of it.
        """
        ratio = []
        for recording in self.base.grasps:
            tracks = recording.tracks
            touching = tracks.episode >= 0
            flesh = float((self.compliance * tracks.unit_displacement[touching]).std())
            gel = float(np.sqrt((tracks.gel_displacement_mm[touching] ** 2).sum(axis=1).mean()))
            ratio.append(flesh / gel)
        return max(1.0, float(np.median(ratio)) / SOFT)

    def moved_by_stress(
        self, recording: GraspResponse, stress: Float[np.ndarray, "r m 4 6"]
    ) -> Float[np.ndarray, "r n 3"]:
        """Displacement of the markers, mm, that stresses (of unit modulus) added to the flesh's bring."""
        return -self.base.answer(recording, self.points.forces(stress))


def over_all_frames(
    recording: GraspResponse, values: Float[np.ndarray, "f n 3"]
) -> Float[np.ndarray, "t n 3"]:
    """Values of the frames used, in all frames of the recording: zero in the air, in a line between.

    For what depends on the past.
    """
    time = recording.case.history.time_s
    touching = np.any([(pad.episode >= 0).any(axis=1) for pad in recording.case.history.pads], axis=0)
    known = recording.used | ~touching
    whole = np.zeros((len(time), *values.shape[1:]))
    whole[recording.used] = values
    at = np.flatnonzero(known)
    for frame in np.flatnonzero(~known):
        after = int(np.searchsorted(at, frame))
        a, b = at[after - 1], at[min(after, len(at) - 1)]
        share = (time[frame] - time[a]) / max(time[b] - time[a], 1e-12)
        whole[frame] = (1 - share) * whole[a] + share * whole[b]
    return whole
