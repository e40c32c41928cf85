"""Force as a function of a tool's travel: the plain law of a geometry, with any combination of effects."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.foundation import Springs
from fem.indentation.no_contact import first_touch
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, Unknown, Values

#: least depth of the row of springs, mm
SHALLOWEST_MM = 1e-3
#: places of first touches over half a toe, and weights whose sum is 2 (Gauss-Legendre)
TOUCHES = np.polynomial.legendre.leggauss(6)
#: unknowns that may differ between several recordings
OWN = ("E_MPa", "onset_mm", "zero_N", "toe_mm")
#: prior sd of the exponent that bends the force-depth curve: 7 % of the force at a depth of R, for finite
#: strains, an imperfect ball, and friction under it
BEND_SD = 0.1
#: prior sd of the onset over the travel, and of the zero of a load cell over the peak force (set by hand)
ONSET_SD, ZERO_SD = 0.15, 0.005
#: prior sd of the logarithm of the toe's width: a factor of 2.7 either way
TOE_SD = 1.0
#: prior sd on the logit of `ends_held`: flat from 0.1 to 0.9, with tails to sliding and bonded ends
ENDS_SD = 1.7


def suffix_of(number: int) -> str:
    """Suffix of the names of a recording's unknowns: none, _2, _3, ..."""
    return "" if number == 0 else f"_{number + 1}"


@dataclass(frozen=True, kw_only=True)
class Law:
    """The geometry's curve, with the unknowns of the baseline and then of the effects."""

    curve: ContactCurve
    baseline: tuple[Unknown, ...]
    effects: tuple[TraceEffect, ...] = ()

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """All unknowns, in the order of the columns of `force_N`."""
        return self.baseline + tuple(u for effect in self.effects for u in effect.unknowns)

    @property
    def name(self) -> str:
        """Effect names sorted and joined by "+"; "none" for the baseline."""
        return "+".join(sorted(effect.name for effect in self.effects)) or "none"

    def index(self, name: str) -> int:
        """Column of an unknown."""
        return [u.name for u in self.unknowns].index(name)

    def values(self, scaled: Float[np.ndarray, "p k"]) -> dict[str, Float[np.ndarray, " p"]]:
        """Value of each unknown, by name."""
        return {u.name: u.value(scaled[:, j]) for j, u in enumerate(self.unknowns)}

    def force_N(self, trace: IndenterTrace, scaled: Float[np.ndarray, "p k"]) -> Float[np.ndarray, "p t"]:
        """Recorded force per frame for each row of unknowns (on their scales).

        F(t) = zero + added + E factor(deepest) sum of springs of phi(d) (1 + d/R)^bend Phi(d),
        R the curve's length, d = travel - onset - give, times (held/sliding)^ends_held if the ends are not
        known. Effects contribute to added, factor, Phi, the springs' slack and relaxation, and give
        (TraceEffect). The measured force, not the model's, determines the machine's displacement: its noise
        times c is small compared with travel, and no equation remains to be solved. Each of several
        recordings has its own onset and zero, and begins with relaxed and undamaged flesh.
        """
        value = self.values(scaled)
        parts = [
            self._part_N(
                part,
                {**value, **{name: value[at] for name in OWN if (at := f"{name}{suffix_of(k)}") in value}},
            )
            for k, part in zip(trace.numbers, trace.parts, strict=True)
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def curve_N_per_MPa(self, value: Values, level_mm: Float[np.ndarray, "p n"]) -> Float[np.ndarray, "p n"]:
        """The plain curve with bend and ends, without effects."""
        bent = (1 + level_mm / self.curve.length_mm) ** value["bend"][:, None]
        phi = self.curve.force_N_per_MPa(level_mm) * bent
        if self.curve.held_over_sliding is not None:
            phi = phi * self.curve.held_over_sliding(level_mm) ** value["ends_held"][:, None]
        return np.asarray(phi)

    def _part_N(self, trace: IndenterTrace, value: Values) -> Float[np.ndarray, "p t"]:
        """Force of one recording, from its own first touch and zero."""
        given_mm = [effect.give_mm(value, trace) for effect in self.effects if effect.give_mm is not None]
        depth = trace.travel_mm - value["onset_mm"][:, None] - sum(given_mm)
        deepest = np.maximum.accumulate(np.maximum(depth, SHALLOWEST_MM), axis=1)
        early = value["toe_mm"] / 2 if "toe_mm" in value else np.zeros(len(depth))
        springs = Springs.of(lambda level: self._with_toe(value, level, early), deepest[:, -1] + early)
        slack, relaxation = None, None
        for effect in self.effects:
            if effect.slack_mm is not None:
                slack = effect.slack_mm(value, self.curve, deepest, springs.level_mm[:, :-1])
            if effect.relaxation is not None:
                relaxation = effect.relaxation(value)
        pressed = depth + early[:, None]
        if relaxation is None:
            force = springs.elastic_force(pressed, slack)
        else:
            force = springs.relaxing_force(trace.time_s, pressed, slack, *relaxation)
        for effect in self.effects:
            if effect.force_factor is not None:
                force = force * effect.force_factor(value, self.curve, depth, deepest)
        drift = value["drift_N_per_min"][:, None] * (trace.time_s - trace.time_s[0]) / 60
        added_N = [effect.added_N(value, trace) for effect in self.effects if effect.added_N is not None]
        return np.asarray(value["E_MPa"][:, None] * force + value["zero_N"][:, None] + drift + sum(added_N))

    def _with_toe(
        self, value: Values, level_mm: Float[np.ndarray, "p n"], early_mm: Float[np.ndarray, " p"]
    ) -> Float[np.ndarray, "p n"]:
        """The curve with its stress factors, at depths from the earliest first touch: the mean over touches
        that are uniform over the toe's width.
        """
        mean = np.zeros_like(level_mm)
        factors = [effect.stress_factor for effect in self.effects if effect.stress_factor is not None]
        for touch, weight in zip(*TOUCHES, strict=True) if early_mm.any() else [(0.0, 2.0)]:
            level = np.maximum(level_mm - (1 + touch) * early_mm[:, None], 0.0)
            phi = weight / 2 * self.curve_N_per_MPa(value, level)
            for factor in factors:
                phi = phi * factor(value, self.curve, level)
            mean += phi
        return mean


def linear_law(trace: IndenterTrace, *, thickness_mm: float | None, poisson_ratio: float) -> Law:
    """The geometry's curve with its nuisances.

    Common to all recordings: E; `bend`, force times (1 + d/length)^bend; the load cell's drift
    (`trace.drift_sd_N_per_min`); for unknown ends `ends_held`, from 0 (sliding) to 1 (bonded).
    For each recording: the travel at first touch, the cell's zero, and for flat ends the toe, the width over
    which first touches are spread.
    """
    curve = trace.geometry.curve(thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    recording_unknowns = [
        _own(part, suffix_of(k), curve.toe_mm) for k, part in zip(trace.numbers, trace.parts, strict=True)
    ]
    onsets_mm = np.array([onset.mean for onset, *_ in recording_unknowns])
    deepest_mm = np.maximum([part.travel_mm.max() for part in trace.parts] - onsets_mm, SHALLOWEST_MM)
    peaks = [np.abs(part.force_N).max() for part in trace.parts]
    guess = float(np.mean(np.log(peaks / curve.force_N_per_MPa(deepest_mm))))
    ends = Unknown(name="ends_held", unit="1", scale="logit", mean=0.0, sd=ENDS_SD)
    return Law(
        curve=curve,
        baseline=(
            Unknown(name="E_MPa", unit="MPa", scale="log", mean=guess, sd=2.0),
            *(unknown for unknowns in recording_unknowns for unknown in unknowns),
            Unknown(name="bend", unit="1", scale="linear", mean=0.0, sd=BEND_SD),
            Unknown(
                name="drift_N_per_min", unit="N/min", scale="linear", mean=0.0, sd=trace.drift_sd_N_per_min
            ),
            *([] if curve.held_over_sliding is None else [ends]),
        ),
    )


def _own(trace: IndenterTrace, at: str, toe_mm: float) -> tuple[Unknown, ...]:
    """First touch, zero and toe of one recording. The first reading may be the cell's zero or a force, so
    that the zero's standard deviation includes all of it.
    """
    calm = max(first_touch(trace) - 1, 0)
    peak = float(np.abs(trace.force_N).max())
    zero = float(np.median(trace.force_N[: max(calm, 1)]))
    onset_mm, onset_sd = float(trace.travel_mm[calm]), ONSET_SD * float(np.ptp(trace.travel_mm))
    onset = Unknown(name=f"onset_mm{at}", unit="mm", scale="linear", mean=onset_mm, sd=onset_sd)
    zero_sd = float(np.hypot(ZERO_SD * peak, zero))
    offset = Unknown(name=f"zero_N{at}", unit="N", scale="linear", mean=zero, sd=zero_sd)
    if not toe_mm:
        return onset, offset
    toe = Unknown(name=f"toe_mm{at}", unit="mm", scale="log", mean=float(np.log(toe_mm)), sd=TOE_SD)
    return onset, offset, toe
