"""The force that a ball's travel calls for, under any of the effects together."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.indentation.ball import BallOnSlab
from fem.indentation.effects.trace_damage import damage_share
from fem.indentation.effects.trace_effect import TraceEffect
from fem.indentation.effects.trace_plastic_set import plastic_slack_mm
from fem.indentation.effects.trace_stiffening import stiffening_share
from fem.indentation.effects.trace_viscoelastic import arms_of
from fem.indentation.foundation import elastic_force, relaxing_force, springs
from fem.indentation.trace import IndenterTrace
from fem.indentation.unknowns import Unknown

#: least depth that the springs are laid out for, mm
SHALLOWEST_MM = 1e-3


@dataclass(frozen=True, kw_only=True)
class Law:
    """Ball and slab, with the unknowns of the baseline and of the effects taken in, in this order."""

    ball: BallOnSlab
    baseline: tuple[Unknown, ...]
    effects: tuple[TraceEffect, ...] = ()

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Every unknown, as the columns of `force_N` go."""
        return self.baseline + tuple(u for effect in self.effects for u in effect.unknowns)

    @property
    def name(self) -> str:
        """Effect names sorted and joined by "+"; "none" for the baseline."""
        return "+".join(sorted(effect.name for effect in self.effects)) or "none"

    def values(self, scaled: Float[np.ndarray, "p k"]) -> dict[str, Float[np.ndarray, " p"]]:
        """Each unknown by its name."""
        return {u.name: u.value(scaled[:, j]) for j, u in enumerate(self.unknowns)}

    def force_N(self, trace: IndenterTrace, scaled: Float[np.ndarray, "p k"]) -> Float[np.ndarray, "p t"]:
        """Recorded force per frame for each row of unknowns (on their scales).

        F(t) = zero + drift t + E (1 - D(deepest)) sum of springs of phi(d) (1 + d/R)^bend Phi(b d/R),
        d = travel - onset - c F. The measured force, not the model's, gives way in the machine: its noise
        times c is small against travel, and no equation is left to solve.
        """
        value = self.values(scaled)
        zero = np.zeros(len(scaled))
        nu, radius = self.ball.poisson_ratio, self.ball.radius_mm
        depth = trace.travel_mm - value["onset_mm"][:, None]
        if "mm_per_N" in value:
            pushing = trace.force_N - value["zero_N"][:, None]
            depth = depth - value["mm_per_N"][:, None] * pushing
        deepest = np.maximum.accumulate(np.maximum(depth, SHALLOWEST_MM), axis=1)

        def curve(level: Float[np.ndarray, "p n"]) -> Float[np.ndarray, "p n"]:
            strain = level / radius
            phi = self.ball.force_N_per_MPa(level) * (1 + strain) ** value["bend"][:, None]
            if "b" in value:
                phi *= stiffening_share(value["b"][:, None], self.ball.energy_strain(level), poisson_ratio=nu)
            return np.asarray(phi)

        level, stiffness = springs(curve, deepest[:, -1])
        slack = None
        if "yield_over_E" in value:
            slack = plastic_slack_mm(
                value["yield_over_E"][:, None],
                deepest,
                level,
                poisson_ratio=nu,
                radius_mm=radius,
                over_half_space=self.ball.over_half_space(deepest),
            )
        arms = max((effect.arms for effect in self.effects), default=0)
        if arms:
            share, tau_s = arms_of(value, arms)
            force = relaxing_force(trace.time_s, depth, slack, level, stiffness, share, tau_s)
        else:
            force = elastic_force(depth, slack, level, stiffness)
        if "dmax" in value:
            force = force * damage_share(
                value["dmax"][:, None],
                value["W0_over_E"][:, None],
                self.ball.energy_strain(deepest),
                depth / deepest,
                poisson_ratio=nu,
            )
        drift = value.get("newton_per_s", zero)[:, None] * (trace.time_s - trace.time_s[0])
        return np.asarray(value["E_MPa"][:, None] * force + value["zero_N"][:, None] + drift)
