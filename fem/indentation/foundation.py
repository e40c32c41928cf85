"""A viscoelastic contact as a row of independent springs: exact for growing contact and for one unloading.

A convex force-depth curve phi(d) is a row of springs: spring j begins contact at depth y_j and has stiffness
w_j, the jump of phi's slope there, so that sum w_j (d - y_j)+ is phi. Each spring relaxes like the flesh, and
leaves the ball when its force falls to zero. While contact grows, the sum is Lee and Radok's integral,
F = int R(t - s) d phi(d(s)). During unloading the last spring in contact is the one with
int_{t1}^{t} R(t - s) dd(s) = 0, which is Ting's condition for the shrinking contact, and the force is Ting's.
Unlike Ting's formula, the row is valid for any number of cycles. On a half-space the row is exact; on a slab
it is exact while contact grows.

Sources: Lee and Radok, "The contact problem for viscoelastic bodies", J. Appl. Mech. 27, 1960, 438-444;
Ting, "The contact stresses between a rigid indenter and a viscoelastic half-space", J. Appl. Mech. 33, 1966,
845-854; Argatov and Popov, "Rebound indentation problem for a viscoelastic half-space and axisymmetric
indenter: solution by the method of dimensionality reduction", ZAMM 96, 2016, 956-967.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

#: number of springs; the error of the force is about a third of its inverse square, relative to the largest
SPRINGS = 40
#: share of the largest depth by which a ball may go back and still count as loading
JITTER = 1e-3


@dataclass(frozen=True, kw_only=True)
class Springs:
    """p piecewise linear curves: force at the depths `level_mm`."""

    level_mm: Float[np.ndarray, "p m"]
    curve: Float[np.ndarray, "p m"]

    @classmethod
    def of(
        cls,
        curve: Callable[[Float[np.ndarray, "p m"]], Float[np.ndarray, "p m"]],
        deepest_mm: Float[np.ndarray, " p"],
    ) -> "Springs":
        """Springs up to the deepest; levels grow quadratically, denser at first touch."""
        level = deepest_mm[:, None] * (np.arange(SPRINGS + 1) / SPRINGS) ** 2
        return cls(level_mm=level, curve=curve(level))

    @property
    def stiffness(self) -> Float[np.ndarray, "p n"]:
        """w of each spring, which begins contact at its level; the last level has none."""
        slope = np.diff(self.curve) / np.diff(self.level_mm)
        return np.diff(slope, prepend=0.0, axis=1)

    def pressed_mm(
        self, depth_mm: Float[np.ndarray, "p t"], slack_mm: Float[np.ndarray, "p t n"] | None
    ) -> Float[np.ndarray, "p t n"]:
        """Compression of each spring, (d - y - slack)+."""
        pressed = depth_mm[:, :, None] - self.level_mm[:, None, :-1]
        return np.asarray(np.maximum(pressed if slack_mm is None else pressed - slack_mm, 0.0))

    def elastic_force(
        self, depth_mm: Float[np.ndarray, "p t"], slack_mm: Float[np.ndarray, "p t n"] | None = None
    ) -> Float[np.ndarray, "p t"]:
        """Elastic force: the curve itself, or, with slack, the springs' compressions times stiffnesses."""
        if slack_mm is None:
            rows = zip(depth_mm, self.level_mm, self.curve, strict=True)
            return np.stack([np.interp(*row) for row in rows])
        return np.asarray(np.einsum("ptn,pn->pt", self.pressed_mm(depth_mm, slack_mm), self.stiffness))

    def relaxing_force(
        self,
        time_s: Float[np.ndarray, " t"],
        depth_mm: Float[np.ndarray, "p t"],
        slack_mm: Float[np.ndarray, "p t n"] | None,
        share: Float[np.ndarray, "k p"],
        tau_s: Float[np.ndarray, "k p"],
    ) -> Float[np.ndarray, "p t"]:
        """Force with relaxation R(t) = 1 - sum g + sum g exp(-t/tau); depth is linear between frames.

        Spring compression v and arm states Q_k obey Q_k' = e_k Q_k + g_k c_k (v' - v), e = exp(-dt/tau),
        c = tau/dt (1 - e), exact for linear v. During loading, one such recursion is sufficient for the whole
        row. Springs in contact in the first frame start relaxed, as after a long contact.
        """
        step = np.diff(time_s)[:, None, None] / tau_s
        fade = np.exp(-step)
        take = share * -np.expm1(-step) / step
        rest = 1 - share.sum(axis=0)
        turn = last_growing_frame(depth_mm)
        first = None if slack_mm is None else slack_mm[:, : turn + 1]
        whole = self.elastic_force(depth_mm[:, : turn + 1], first).T
        added = take[:turn] * np.diff(whole, axis=0)[:, None]
        arms = np.zeros((turn + 1, *tau_s.shape))
        for k in range(turn):
            arms[k + 1] = fade[k] * arms[k] + added[k]
        growing = rest * whole + arms.sum(axis=1)
        if turn == len(time_s) - 1:
            return np.asarray(growing.T)

        pressed = self.pressed_mm(depth_mm[:, : turn + 1], first)
        weight = take[:turn] * np.exp(-(time_s[turn] - time_s[1 : turn + 1])[:, None, None] / tau_s)
        state = np.einsum("tkp,ptn->kpn", weight, np.diff(pressed, axis=1), optimize=True)
        later = None if slack_mm is None else slack_mm[:, turn + 1 :]
        demanded = np.moveaxis(self.pressed_mm(depth_mm[:, turn + 1 :], later), 1, 0)
        always = np.ones((len(time_s) - 1 - turn, 1, len(rest)))
        springs_N = _any_path(
            demanded,
            np.concatenate([(rest[:, None] * pressed[:, -1])[None], state]),
            pressed[:, -1],
            np.concatenate([always, fade[turn:]], axis=1)[..., None],
            np.concatenate([always * rest, take[turn:]], axis=1)[..., None],
        )
        return np.concatenate([growing.T, np.einsum("tpn,pn->pt", springs_N, self.stiffness)], axis=1)


def last_growing_frame(depth_mm: Float[np.ndarray, "p t"]) -> int:
    """The last frame before any row's depth decreases by more than JITTER, a thousandth of its largest."""
    back = np.maximum.accumulate(depth_mm, axis=1) - depth_mm
    touched = np.maximum.accumulate(depth_mm, axis=1) > 0
    falls = ((back > JITTER * depth_mm.max(axis=1, keepdims=True)) & touched).any(axis=0)
    return int(np.argmax(falls)) - 1 if falls.any() else depth_mm.shape[1] - 1


def _any_path(
    demanded_mm: Float[np.ndarray, "t p n"],
    parts: Float[np.ndarray, "k p n"],
    pressed_mm: Float[np.ndarray, "p n"],
    fade: Float[np.ndarray, "t k p 1"],
    take: Float[np.ndarray, "t k p 1"],
) -> Float[np.ndarray, "t p n"]:
    """Force of each spring over its stiffness, frame by frame from a known state.

    `parts`: the spring that never relaxes (fade 1) and the arms. Out of contact, v changes such that their
    sum stays zero. If the ball prescribes a larger v, the spring is in contact and has that v.
    """
    stiff = take.sum(axis=1)
    force = np.empty_like(demanded_mm)
    for i, wanted in enumerate(demanded_mm):
        parts = parts * fade[i]
        held = parts.sum(axis=0)
        moved = np.maximum(-held / stiff[i], wanted - pressed_mm)
        parts += take[i] * moved
        pressed_mm = pressed_mm + moved
        force[i] = held + stiff[i] * moved
    return force
