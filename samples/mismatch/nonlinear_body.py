"""A fruit with a material law: equilibrium by alternating contact and flesh.

An iteration takes the displacement q of all unknowns. It computes the skin's free displacement from the
stress in excess of the linear one, and solves the contact with the dense linear compliance:

    freely = -K^-1 excess(q),        q' = freely + K^-1 P f,   f the pads' forces on the skin at q'

Thus pads hold the fruit in each iteration as in the solution. Anderson mixing (Walker and Ni 2011, type II)
accelerates the iterations until q no longer changes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from fem.sparse.solver import Factor, factorise
from samples.brick_flesh import BrickFlesh
from samples.mismatch.flesh_laws import FleshLaw, Lame, PlainFlesh, State
from samples.mismatch.grip import Grip, Instant, before_touch, going_on, next_instant
from samples.mismatch.meshed_fruit import MeshedFruit
from samples.mismatch.skin_compliance import SkinCompliance, compliance_of
from samples.sample_failure import NotInEquilibrium

PointStress = Callable[[Float[np.ndarray, "m 27 3 3"]], Float[np.ndarray, "m 27 3 3"]]
"""Stress (MPa) at the integration points as a function of the displacement gradients there."""


@dataclass(frozen=True, kw_only=True)
class WholeFruit:
    """Flesh with its factorised stiffness, and its patches' compliance.

    `stiffness`: the factorised one, close to that of the flesh at rest. `support`: stiffness of a skin or of
    springs, linear in the unknowns. `slopes`: gradients of the shape functions at the integration points,
    three rows for each.
    """

    flesh: BrickFlesh
    factor: Factor
    compliance: SkinCompliance
    stiffness: csr_array
    support: csr_array | None
    slopes: Float[np.ndarray, "m 81 27"]
    dofs: Int[np.ndarray, " d"]

    def excess(self, q: Float[np.ndarray, " u"], stress: PointStress) -> Float[np.ndarray, " u"]:
        """Internal forces on the unknowns from the `stress` and `support`, minus those of the factorised
        stiffness; the pit rotates through any angle.
        """
        nodal = self._nodal_force(stress(self._gradients(self.flesh.displacement(q))))
        force = self.flesh.on_unknowns(nodal, q) - self.stiffness @ q
        return np.asarray(force if self.support is None else force + self.support @ q)

    def _gradients(self, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 27 3 3"]:
        """Displacement gradient du_i/dx_k at the integration points."""
        gradients = np.matmul(self.slopes, u[self.flesh.bricks.cells])
        return np.asarray(gradients.reshape(-1, 27, 3, 3).transpose(0, 1, 3, 2))

    def _nodal_force(self, stress: Float[np.ndarray, "m 27 3 3"]) -> Float[np.ndarray, "n 3"]:
        """Nodal forces of a stress field P_ik (first index: direction of the force)."""
        cells = self.flesh.bricks.cells
        m = len(cells)
        weighted = stress.transpose(0, 1, 3, 2) * self.flesh.volumes[..., None, None]
        local = np.matmul(self.slopes.transpose(0, 2, 1), weighted.reshape(m, 81, 3))
        count = len(self.flesh.bricks.nodes_mm)
        nodal = [np.bincount(cells.ravel(), local[..., i].ravel(), minlength=count) for i in range(3)]
        return np.stack(nodal, axis=1)

    def solve(self, force_N: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
        """Displacement of all unknowns under forces on them."""
        return self.factor.solve(force_N[:, None])[:, 0]

    def solve_skin(self, force_N: Float[np.ndarray, " u"]) -> Float[np.ndarray, " d"]:
        """Displacement of the patches' unknowns alone, under forces on all unknowns."""
        return self.factor.solve_at(force_N[:, None], self.dofs)[:, 0]

    def spread(self, force_N: Float[np.ndarray, " d"]) -> Float[np.ndarray, " u"]:
        """Forces on the patches' unknowns as forces on all."""
        full = np.zeros(self.flesh.unknowns)
        full[self.dofs] = force_N
        return full


def whole_fruit(
    flesh: BrickFlesh,
    dofs: Int[np.ndarray, " d"],
    *,
    stiffness: csr_array | None = None,
    support: csr_array | None = None,
) -> WholeFruit:
    """Factorise the flesh's stiffness at rest (None: plain flesh's) plus that of a skin or springs."""
    whole = flesh.stiffness if stiffness is None else stiffness
    if support is not None:
        whole = csr_array(whole + support)
    factor = factorise(whole)
    slopes = np.ascontiguousarray(flesh.slopes.transpose(0, 1, 3, 2)).reshape(-1, 81, 27)
    return WholeFruit(
        flesh=flesh, factor=factor, compliance=compliance_of(factor, dofs), stiffness=whole, support=support,
        slopes=slopes, dofs=dofs,
    )  # fmt: skip


CONVERGED_MM = 4e-5
"""mm, largest change of a skin node in an iteration: a hundredth of a frame's noise of 4 um
(samples.mismatch.marker_sensor)."""
LET_GO_N = 0.5
"""N, sum of all nodes' forces along all axes: 0.15 N from each pad. Below it, the springs that support the
fruit (0.02 N/mm) drag it along by a millimetre and more."""
REST_S = 1e4
"""Seconds between two grasps."""
DRAWN_MM = 0.5
"""mm: between parting pads that hardly press, the support springs drag a skin node that moves farther in one
step, and the grip has ended. Set by hand: ten times the motion of a converged step (0.045 mm)."""
ROUNDS, DEPTH = 60, 8
"""Iterations before a step counts as not converged and is halved, and earlier ones in the mix (set by
hand)."""
HALVINGS = 3
"""Most halvings of a step that does not converge; the halves start without the trend of earlier steps."""


class NonlinearBody:
    """Flesh with a law per point; it keeps the law's state from grasp to grasp."""

    def __init__(self, whole: WholeFruit, law: FleshLaw, *, firmer: float = 1.0) -> None:
        """`firmer`: factor on the linear stiffness in the iterations, above 1 for stiffening flesh."""
        self._whole, self._compliance, self._law = whole, whole.compliance.scaled(1 / firmer), law
        self._firmer = firmer
        self.still = law.still
        self._state: State = law.at_first(whole.flesh.volumes.shape)
        self._q = np.zeros(whole.flesh.unknowns)
        self._trend = np.zeros(whole.flesh.unknowns)

    @property
    def displacement_mm(self) -> Float[np.ndarray, " u"]:
        """Displacement of all unknowns at the last instant."""
        return self._q

    def begin(self) -> Float[np.ndarray, " d"]:
        """The unloaded skin's displacement under residual stress. Raises NotInEquilibrium."""
        return self._unloaded(REST_S)

    def _unloaded(self, pause_s: float) -> Float[np.ndarray, " d"]:
        q, mixing = np.zeros_like(self._q), AndersonMixing(DEPTH)
        for _ in range(ROUNDS):
            excess, state = self._excess(q, pause_s)
            mapped = ((self._firmer - 1) * q - self._whole.solve(excess)) / self._firmer
            if np.abs(mapped - q).max() < CONVERGED_MM / 10:
                break
            q = mixing.mixed(q, mapped)
        else:
            raise NotInEquilibrium(f"unloaded flesh found no balance in {ROUNDS} rounds")
        self._state, self._q, self._trend = state, mapped, np.zeros_like(mapped)
        return np.asarray(mapped[self._whole.dofs])

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """Equilibrium of contact and flesh; a step that does not converge is halved.

        Parting pads with hardly any force let go, because the support springs would drag the fruit along.
        """
        return self._in_steps(grip, before, origins, pause_s, HALVINGS)

    def _in_steps(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float, halvings: int
    ) -> Instant:
        loose = _apart_mm(origins) > _apart_mm(before.origins) and np.abs(before.force_N).sum() < LET_GO_N
        try:
            return self._in_one(grip, before, origins, pause_s, most_mm=DRAWN_MM if loose else np.inf)
        except NotInEquilibrium:
            if loose:
                return before_touch(grip, origins, self._unloaded(pause_s))
            if not halvings:
                raise
        self._trend = np.zeros_like(self._trend)
        half = (before.origins + origins) / 2
        middle = self._in_steps(grip, before, half, pause_s / 2, halvings - 1)
        return self._in_steps(grip, middle, origins, pause_s / 2, halvings - 1)

    def _in_one(
        self,
        grip: Grip,
        before: Instant,
        origins: Float[np.ndarray, "2 3"],
        pause_s: float,
        *,
        most_mm: float,
    ) -> Instant:
        whole = self._whole
        q, start = self._q + going_on(before, origins) * self._trend, None
        mixing = AndersonMixing(DEPTH)
        for _ in range(ROUNDS):
            excess, state = self._excess(q, pause_s)
            freely = ((self._firmer - 1) * q[whole.dofs] - whole.solve_skin(excess)) / self._firmer
            instant = next_instant(
                grip, before, origins, self._compliance, freely, start=start, near=q[whole.dofs]
            )
            if np.abs(instant.u - before.u).max() > most_mm:
                raise NotInEquilibrium("the fruit slid between pads that hardly press")
            balance = whole.spread(instant.force_N) - excess
            mapped = ((self._firmer - 1) * q + whole.solve(balance)) / self._firmer
            start = instant.force_N
            if np.abs((mapped - q)[whole.dofs]).max() < CONVERGED_MM:
                self._trend = (mapped - self._q) if np.any(instant.force_N) else np.zeros_like(mapped)
                self._state, self._q = state, mapped
                return instant
            q = mixing.mixed(q, mapped)
        raise NotInEquilibrium(f"flesh and contact found no balance in {ROUNDS} rounds: press less")

    def _excess(self, q: Float[np.ndarray, " u"], pause_s: float) -> tuple[Float[np.ndarray, " u"], State]:
        """Forces of the flesh's stress in excess of the linear one at q, and the law's next state."""
        state = self._state

        def stress(H: Float[np.ndarray, "m 27 3 3"]) -> Float[np.ndarray, "m 27 3 3"]:
            nonlocal state
            P, state = self._law.stress(H, self._state, pause_s)
            return P

        return self._whole.excess(q, stress), state


def sound_body(stands: MeshedFruit) -> NonlinearBody:
    """The body of one mesh with plain flesh."""
    lame = Lame(mu=stands.flesh.mu_MPa, lam=stands.flesh.lam_MPa)
    return NonlinearBody(whole_fruit(stands.flesh, stands.dofs), PlainFlesh(lame=lame))


def _apart_mm(origins: Float[np.ndarray, "2 3"]) -> float:
    return float(np.linalg.norm(origins[1] - origins[0]))


class AndersonMixing:
    """The last `depth` iterations and their mix; fem's code is not used, so that truth stays independent."""

    def __init__(self, depth: int) -> None:
        self._depth = depth
        self._mapped: list[np.ndarray] = []
        self._change: list[np.ndarray] = []

    def mixed(self, q: Float[np.ndarray, " u"], mapped: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
        """The next guess; `mapped` is the result of an iteration from the guess q."""
        self._mapped = [*self._mapped[-self._depth :], mapped]
        self._change = [*self._change[-self._depth :], mapped - q]
        if len(self._change) == 1:
            return mapped
        steps = np.stack([b - a for a, b in zip(self._change[:-1], self._change[1:], strict=True)], axis=1)
        moves = np.stack([b - a for a, b in zip(self._mapped[:-1], self._mapped[1:], strict=True)], axis=1)
        share, *_ = np.linalg.lstsq(steps, self._change[-1], rcond=1e-10)
        return np.asarray(mapped - moves @ share)
