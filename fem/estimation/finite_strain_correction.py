"""What large deformation adds to a recording: the markers' displacement beyond the linear answer.

A fruit of modulus E under forces f moves its markers by U(f / E), of which linear flesh has c(f) / E. With
correction(E) = E U(f / E) - c(f), the linear estimator holds for U as well, with c + correction in the place
of c. The correction is small, and quadratic and cubic in the forces to leading order; so it is computed in a
few frames and predicted for the others by the kernel  k(t, s) = a^2 + a^3,  a(t, s) = f_t . c_s  the work of
one frame's forces on another's displacement (scaled), which is exact for such maps where enough frames were
computed. They are chosen greedily, each where the earlier ones predict least (pivoted Cholesky; Schaback and
Wendland, "Kernel techniques", Acta Numerica 15, 2006, section 8).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import PadLink, pad_link

MOST_LEVELS = 12
"""Frames computed at most: each is a nonlinear solution. Set by hand; UNPREDICTED ends the row before it."""
UNPREDICTED = 0.005
"""Frames are computed until what is left to predict is below this share of the largest correction."""
AGREED = 1e-3
"""Relative change of the modulus below which it is taken as found."""
ROUNDS, REPETITIONS = 4, 40
"""Corrections computed anew, and refits with each of them. A repetition keeps of the error the share that is
not linear, a tenth or two, so that far fewer do where E settles at all."""
TOLERANCE = 1e-5
"""Forces out of balance, as a share of the load: a correction of a tenth is then exact to a few 1e-4."""


@dataclass(frozen=True, kw_only=True)
class MarkerContact:
    """Where all pads' markers sit on a solid that was factorised for their contact nodes."""

    solid: UnitModulusSolid
    links: tuple[PadLink, ...]

    @classmethod
    def of(cls, history: GraspHistory, solid: UnitModulusSolid) -> "MarkerContact":
        """Raises FemFailure: off-surface."""
        return cls(solid=solid, links=tuple(pad_link(pad, solid) for pad in history.pads))

    def nodal_force(self, force_N: Float[np.ndarray, "k m 3"]) -> Float[np.ndarray, "k n 3"]:
        """Forces on all nodes from those at the markers, pad by pad."""
        nodal = np.zeros((len(force_N), *self.solid.mesh.nodes_mm.shape))
        counts = np.cumsum([len(link.place.point_mm) for link in self.links])[:-1]
        for link, force in zip(self.links, np.split(force_N, counts, axis=1), strict=True):
            nodal[:, self.solid.contact_nodes] += link.nodal_force(np.ascontiguousarray(force))
        return nodal

    def at_markers(self, moved: Float[np.ndarray, "k n 3"]) -> Float[np.ndarray, "k m 3"]:
        """A nodal field read off at the markers."""
        under = moved[:, self.solid.contact_nodes]
        return np.concatenate([link.at_markers(under) for link in self.links], axis=1)


@dataclass(frozen=True, kw_only=True)
class FiniteStrainCorrection:
    """E U(f / E) - c(f) at the markers in every frame, mm MPa, for E = `modulus_MPa`.

    `computed`: the frames in which it was computed; in the others it is predicted, `unpredicted` being the
    largest share of the largest correction that this may miss. `moved_mm`: nodal displacements there.
    """

    modulus_MPa: float
    displacement_correction: Float[np.ndarray, "t m 3"]
    computed: Int[np.ndarray, " k"]
    unpredicted: float
    moved_mm: Float[np.ndarray, "k n 3"] = field(repr=False)


def finite_strain_correction(
    finite: FiniteStrainSolid,
    contact: MarkerContact,
    force_N: Float[np.ndarray, "t m 3"],
    unit_displacement: Float[np.ndarray, "t m 3"],
    *,
    modulus_MPa: float,
    before: FiniteStrainCorrection | None = None,
) -> FiniteStrainCorrection:
    """The correction in all frames, from the forces at the markers and their linear response to them.

    Add it to `MarkerTracks.unit_displacement` (or take correction / E from the positions) and fit again.
    `before`, the same at another modulus, spares most of the search. Raises NOT_CONVERGED where a frame's
    forces cannot be borne by flesh of this modulus.
    """
    work = np.einsum("tmx,smx->ts", force_N, unit_displacement, optimize=True)
    kernel = _kernel(work)
    chosen, left = _chosen(kernel)
    chosen = chosen[np.argsort(np.diag(work)[chosen])]
    load = contact.nodal_force(force_N[chosen]) / modulus_MPa
    linear_mm = contact.solid.displacement(load)
    start = None
    if before is not None and np.array_equal(before.computed, chosen):
        change = before.modulus_MPa / modulus_MPa
        start = linear_mm + change**2 * (before.moved_mm - linear_mm / change)
    found = finite.displacement(load, start=start, tolerance=TOLERANCE)
    moved_mm = found.require_equilibrium().displacement
    beyond = modulus_MPa * contact.at_markers(moved_mm - linear_mm)
    own = kernel[np.ix_(chosen, chosen)]
    weights = np.linalg.solve(own + 1e-10 * np.trace(own) * np.eye(len(chosen)), kernel[chosen])
    return FiniteStrainCorrection(
        modulus_MPa=modulus_MPa,
        displacement_correction=np.einsum("kt,kmx->tmx", weights, beyond, optimize=True),
        computed=chosen,
        unpredicted=left,
        moved_mm=moved_mm,
    )


def finite_modulus(
    finite: FiniteStrainSolid,
    contact: MarkerContact,
    force_N: Float[np.ndarray, "t m 3"],
    unit_displacement: Float[np.ndarray, "t m 3"],
    *,
    modulus_MPa: float,
    refit: Callable[[Float[np.ndarray, "t m 3"]], float],
) -> tuple[float, FiniteStrainCorrection]:
    """The modulus E for which a refit with c + correction(E) gives 1/E, from the linear one on.

    `refit` takes the markers' unit displacement and returns the compliance, 1/MPa. Between computations the
    correction is taken to go like 1/E. Raises NOT_CONVERGED where ROUNDS of them do not settle E to AGREED.
    """
    found = None
    for _ in range(ROUNDS):
        found = finite_strain_correction(
            finite, contact, force_N, unit_displacement, modulus_MPa=modulus_MPa, before=found
        )
        computed_at, modulus_MPa = modulus_MPa, _repeated(found, unit_displacement, refit)
        nonlinear = float(np.linalg.norm(found.displacement_correction) / np.linalg.norm(unit_displacement))
        if abs(modulus_MPa / computed_at - 1) * nonlinear < AGREED / 2:
            return modulus_MPa, found
    raise FemFailure(
        FemProblem.NOT_CONVERGED,
        f"found {computed_at:.4f} and then {modulus_MPa:.4f} MPa after {ROUNDS} rounds of large deformation; "
        f"expected them to agree to {AGREED:.1%}: check the forces, or use the linear model",
    )


def _repeated(
    found: FiniteStrainCorrection,
    unit_displacement: Float[np.ndarray, "t m 3"],
    refit: Callable[[Float[np.ndarray, "t m 3"]], float],
) -> float:
    """E = 1 / refit(c + correction (E0 / E)), repeated. Raises NOT_CONVERGED where E goes on changing."""
    modulus = found.modulus_MPa
    for _ in range(REPETITIONS):
        before = modulus
        compliance = refit(unit_displacement + found.displacement_correction * (found.modulus_MPa / modulus))
        if not (np.isfinite(compliance) and compliance > 0):
            raise FemFailure(
                FemProblem.NO_MODULUS,
                f"found a compliance of {compliance:.3g} per MPa with large deformation, expected one above "
                "zero; use the linear model, and check the signs of force and pose",
            )
        modulus = 1 / compliance
        if abs(modulus / before - 1) < AGREED / 100:
            return modulus
    raise FemFailure(
        FemProblem.NOT_CONVERGED,
        f"E with large deformation still changes from {before:.4f} to {modulus:.4f} MPa after {REPETITIONS} "
        "repetitions; use the linear model, and check the forces",
    )


def _kernel(work: Float[np.ndarray, "t t"]) -> Float[np.ndarray, "t t"]:
    """a^2 + a^3, a the work of the frames on each other as a share of the greatest frame's own."""
    a = (work + work.T) / (2 * np.diag(work).max())
    return np.asarray(a**2 + a**3)


def _chosen(kernel: Float[np.ndarray, "t t"]) -> tuple[Int[np.ndarray, " k"], float]:
    """Frames by pivoted Cholesky, and the largest share that the others are left unforetold."""
    left, columns, chosen = np.diag(kernel).copy(), np.zeros((len(kernel), 0)), list[int]()
    greatest = left.max()
    while len(chosen) < min(MOST_LEVELS, len(kernel)) and np.sqrt(left.max() / greatest) > UNPREDICTED:
        pivot = int(left.argmax())
        column = (kernel[:, pivot] - columns @ columns[pivot]) / np.sqrt(left[pivot])
        columns = np.column_stack([columns, column])
        left = np.maximum(left - column**2, 0.0)
        left[[*chosen, pivot]] = 0.0
        chosen.append(pivot)
    return np.array(chosen), float(np.sqrt(left.max() / greatest))
