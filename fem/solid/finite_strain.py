"""Displacement of the flesh under large deformation: equilibrium of a `UnitModulusSolid` under another law.

Since every stress grows with E, a fruit of modulus E under forces f moves like one of 1 MPa under f / E.

A free fruit is in balance in its deformed shape: of the potential  W(u) - f . u + alpha . B'u  both
derivatives vanish, so that u has no mean translation and rotation over the flesh (B'u = 0, as in
`FreeBody.without_rigid_motion`) and the six alpha are a smooth body force B alpha (`FreeBody.balance`), here
one that balances force and moment where the loads have moved to. The linear solid is the limit of small
loads. The pit turns by any angle (fem.solid.finite_rotation).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.cached_value import cached_value
from fem.fem_failure import FemFailure, FemProblem
from fem.materials.law import UnitLaw
from fem.solid.equilibrium import Ending, Tangent, Tangents, equilibrium
from fem.solid.finite_strain_balance import FiniteBalance
from fem.solid.finite_strain_elements import FiniteFlesh
from fem.solid.linear_solid import UnitModulusSolid

TOLERANCE = 1e-7
"""Forces out of balance, as a share of the load; displacements are then exact to about as much."""
ITERATIONS = 40
"""Steps of Newton's method under one load at most; hopeless ones are given up before. Set by hand."""
SMALLEST_SHARE = 1 / 64
"""The load is applied in smaller and smaller steps where it cannot be at once; below this one we stop."""
SIMILAR = 0.9
"""Cosine between two loads from which on one's difference from the linear answer predicts the other's."""


@dataclass(frozen=True, kw_only=True)
class FiniteResult:
    """Displacements under f loads, and how the search for each ended.

    `displacement`: in mm, of a fruit of modulus E under E times the loads given. `share`: how much of each
    load it balances; below one where the search stopped, and this is the last displacement in balance.
    `out_of_balance`: the residual left, as a share of the load (2-norm over the unknowns).
    """

    displacement: Float[np.ndarray, "f n 3"]
    share: Float[np.ndarray, " f"]
    ending: tuple[Ending, ...]
    iterations: tuple[int, ...]
    tangents: tuple[int, ...]
    out_of_balance: Float[np.ndarray, " f"]

    def require_equilibrium(self) -> "FiniteResult":
        """This result; raises NOT_CONVERGED with the first load that is not balanced."""
        for k in np.flatnonzero(self.share < 1):
            raise FemFailure(
                FemProblem.NOT_CONVERGED,
                f"load {k + 1} of {len(self.share)} is balanced up to {self.share[k]:.0%} of it and no "
                f"further ({self.ending[k].value}); expected a load that the flesh can bear: check forces "
                "and modulus, or mesh finer where the load acts",
            )
        return self


@dataclass(frozen=True, kw_only=True)
class FiniteStrainSolid:
    """A factorised linear solid, its flesh under a law of finite strain."""

    solid: UnitModulusSolid
    law: UnitLaw

    def __post_init__(self) -> None:
        if self.law.poisson_ratio != self.solid.poisson_ratio:
            raise FemFailure(
                FemProblem.BAD_POISSON_RATIO,
                f"the law has Poisson's ratio {self.law.poisson_ratio:g}, the factorised solid "
                f"{self.solid.poisson_ratio:g}; both must be the same",
            )

    @cached_value
    def flesh(self) -> FiniteFlesh:
        """The elements."""
        return FiniteFlesh.of(self.solid.mesh, self.law)

    @cached_value
    def rest(self) -> FiniteBalance:
        """Without load: all that every load shares, and the linear tangent."""
        return FiniteBalance.of(self.solid, self.flesh)

    def displacement(
        self,
        nodal_force_over_E: Float[np.ndarray, "f n 3"],
        *,
        start: Float[np.ndarray, "f n 3"] | None = None,
        tolerance: float = TOLERANCE,
        keep_factor: bool = True,
    ) -> FiniteResult:
        """The displacement under each of f loads: dead forces on the nodes, N per MPa of the modulus.

        Each search starts from `start`, or from the linear answer plus what the load before, if it was alike,
        has shown to lie beyond it. `keep_factor`: chord steps with the linear factor as long as they serve;
        else a tangent at every step. A load that is not balanced at once is applied in smaller steps; the
        result then holds the last displacement in balance (`share` < 1). Raises BAD_LOAD like the solid.
        """
        linear = self.solid.displacement(nodal_force_over_E)
        found: list[_Loaded] = []
        for k, load in enumerate(nodal_force_over_E):
            last = found[-1] if found and _similar(nodal_force_over_E[k - 1], load) else None
            if start is not None:
                first = start[k]
            else:
                first = linear[k] if last is None else linear[k] + _predicted(linear, last, k)
            tangent = None
            if keep_factor:
                tangent = self.rest.linear_tangent if last is None else last.tangent
            found.append(self._loaded(load, first, tolerance=tolerance, tangent=tangent))
        return FiniteResult(
            displacement=np.stack([one.displacement_mm for one in found]),
            share=np.array([one.share for one in found]),
            ending=tuple(one.ending for one in found),
            iterations=tuple(one.iterations for one in found),
            tangents=tuple(one.tangents for one in found),
            out_of_balance=np.array([one.out_of_balance for one in found]),
        )

    def _loaded(
        self,
        load: Float[np.ndarray, "n 3"],
        first: Float[np.ndarray, "n 3"],
        *,
        tolerance: float,
        tangent: Tangent | None,
    ) -> "_Loaded":
        """One load, at once or in steps: halved where the search fails, doubled where it succeeds."""
        rest, keep = self.rest, tangent is not None
        last = rest.state(np.zeros_like(first))
        share, step, iterations, tangents, left = 0.0, 1.0, 0, 0, 0.0
        ending, guess = Ending.CONVERGED, rest.admissible(first)
        while share < 1 and load.any():
            wanted = min(1.0, share + step)
            result = equilibrium(
                rest.under(wanted * load),
                guess,
                tolerance=tolerance,
                iterations=ITERATIONS,
                tangents=Tangents.WHILE_THEY_SERVE if keep else Tangents.EVERY_STEP,
                tangent=tangent,
            )
            iterations, tangents = iterations + len(result.shares), tangents + result.tangents
            ending = result.ending
            if ending is Ending.CONVERGED:
                before, last, left = last, result.state, result.sizes[-1]
                tangent = result.tangent if keep else None
                step = min(2 * step, 1 - wanted)
                # straight on along the path so far
                guess = rest.between(before, last, 1 + step / (wanted - share)) if step > 0 else last
                share = wanted
            elif step / 2 < SMALLEST_SHARE:
                break
            else:
                step /= 2
                guess = rest.state(step * first) if share == 0 else last
            if keep and tangent is None:
                tangent = rest.linear_tangent
        return _Loaded(
            displacement_mm=last.displacement_mm,
            share=share if load.any() else 1.0,
            ending=ending,
            iterations=iterations,
            tangents=tangents,
            out_of_balance=left,
            tangent=tangent,
        )


@dataclass(frozen=True, kw_only=True)
class _Loaded:
    displacement_mm: Float[np.ndarray, "n 3"]
    share: float
    ending: Ending
    iterations: int
    tangents: int
    out_of_balance: float
    tangent: Tangent | None


def _similar(before: Float[np.ndarray, "n 3"], now: Float[np.ndarray, "n 3"]) -> bool:
    """Whether two loads act alike, though not equally strong."""
    sizes = float(np.linalg.norm(before)) * float(np.linalg.norm(now))
    return float((before * now).sum()) > SIMILAR * sizes


def _predicted(linear: Float[np.ndarray, "f n 3"], last: _Loaded, k: int) -> Float[np.ndarray, "n 3"]:
    """The difference from the linear answer, which grows with the square of a load that keeps its shape."""
    size = float(np.linalg.norm(linear[k])) / float(np.linalg.norm(linear[k - 1]))
    return np.asarray((last.displacement_mm - linear[k - 1]) * size**2 * (last.share == 1))
