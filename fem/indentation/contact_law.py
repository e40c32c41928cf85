"""The force that a tool's travel calls for, under any of the effects together."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.foundation import elastic_force, relaxing_force, springs
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, Values
from fem.indentation.unknowns import Unknown

#: least depth that the springs are laid out for, mm
SHALLOWEST_MM = 1e-3
#: unknowns that each of several recordings has for itself
OWN = ("onset_mm", "zero_N", "toe_mm")


def suffix_of(part: int) -> str:
    """How the unknowns of a recording are told from the first's: none, _2, _3, ..."""
    return "" if part == 0 else f"_{part + 1}"


@dataclass(frozen=True, kw_only=True)
class Law:
    """The geometry's curve, with the unknowns of the baseline and of the effects taken in, in this order."""

    curve: ContactCurve
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

    def depth_mm(self, trace: IndenterTrace, scaled: Float[np.ndarray, " k"]) -> Float[np.ndarray, " t"]:
        """Travel beyond each recording's first touch, less nothing that gives way."""
        value = self.values(scaled[None])
        onset = [float(value[f"onset_mm{suffix_of(k)}"][0]) for k in range(len(trace.parts))]
        return np.concatenate([part.travel_mm - at for part, at in zip(trace.parts, onset, strict=True)])

    def force_N(self, trace: IndenterTrace, scaled: Float[np.ndarray, "p k"]) -> Float[np.ndarray, "p t"]:
        """Recorded force per frame for each row of unknowns (on their scales).

        F(t) = zero + added + E factor(deepest) sum of springs of phi(d) (1 + d/R)^bend Phi(d),
        R the curve's length, d = travel - onset - give, times (held/sliding)^ends_held where the ends are not
        known. Effects have their parts in added, factor, Phi, the
        springs' slack and relaxation, and give (TraceEffect). The measured force, not the model's, gives way
        in the machine: its noise times c is small against travel, and no equation is left to solve. Each of
        several recordings has its own onset and zero, and begins with flesh at rest and unhurt.
        """
        value = self.values(scaled)
        parts = [
            self._part_N(
                part,
                {**value, **{name: value[at] for name in OWN if (at := f"{name}{suffix_of(k)}") in value}},
            )
            for k, part in enumerate(trace.parts)
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def _part_N(self, trace: IndenterTrace, value: Values) -> Float[np.ndarray, "p t"]:
        """Of one recording, from its own first touch and zero."""
        depth = trace.travel_mm - value["onset_mm"][:, None]
        for effect in self.effects:
            if effect.give_mm is not None:
                depth = depth - effect.give_mm(value, trace)
        deepest = np.maximum.accumulate(np.maximum(depth, SHALLOWEST_MM), axis=1)

        def curve(level: Float[np.ndarray, "p n"]) -> Float[np.ndarray, "p n"]:
            strain = level / self.curve.length_mm
            phi = self.curve.force_N_per_MPa(level) * (1 + strain) ** value["bend"][:, None]
            held = self.curve.held_over_sliding(level)
            if held is not None:
                phi = phi * held ** value["ends_held"][:, None]
            for effect in self.effects:
                if effect.stress_factor is not None:
                    phi = phi * effect.stress_factor(value, self.curve, level)
            return np.asarray(phi)

        level, stiffness = springs(curve, deepest[:, -1])
        slack = None
        for effect in self.effects:
            if effect.slack_mm is not None:
                own = effect.slack_mm(value, self.curve, deepest, level)
                slack = own if slack is None else slack + own
        relaxation = next((one.relaxation for one in self.effects if one.relaxation is not None), None)
        if relaxation is None:
            force = elastic_force(depth, slack, level, stiffness, value.get("toe_mm"))
        else:
            share, tau_s = relaxation(value)
            force = relaxing_force(
                trace.time_s, depth, slack, level, stiffness, share, tau_s, value.get("toe_mm")
            )
        for effect in self.effects:
            if effect.force_factor is not None:
                force = force * effect.force_factor(value, self.curve, depth, deepest)
        elapsed_min = (trace.time_s - trace.time_s[0]) / 60
        drift = value["drift_N_per_min"][:, None] * elapsed_min
        total = value["E_MPa"][:, None] * force + value["zero_N"][:, None] + drift
        for effect in self.effects:
            if effect.added_N is not None:
                total = total + effect.added_N(value, trace)
        return np.asarray(total)
