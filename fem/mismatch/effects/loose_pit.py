"""`loose_pit`: freestone. An even gap lies between flesh and pit, closed by being pressed, without friction.

With no pit the flesh answers the measured forces f and pressures p on its inner surface linearly; at every
patch of that surface, u_n its displacement out of the pit and v_n the rigid pit's,

    gap / s + u_n(f, p) - v_n >= 0,      p >= 0,      p (gap / s + u_n - v_n) = 0,      pit in equilibrium

for E = 1 MPa: Signorini's conditions (Kikuchi and Oden 1988, Contact Problems in Elasticity). The answer
depends on the forces of the moment alone. These are of a pit that turns until next to no moment is left on
it. One that friction holds (fem.mismatch.model.loose_flesh) does not turn; pressed askew, flesh about an
oblong pit gives way up to three times as much more than bonded flesh if the pit turns, so that these are two
ways of the effect to show. Signature: this less the bonded answer, for a few gaps and both ways, amount 1.
However small the gap, the amount is not: what asks for less than LEAST_AMOUNT of it is something else.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.effect import Amounts, Effect, Parameters, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.loose_flesh import loose_flesh
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.signature_variant import Variant, significant
from fem.solid.unilateral_contact import pressures

GAP = "gap_mm"
GAPS_MM = (0.03, 0.06, 0.1, 0.15, 0.21, 0.28, 0.36, 0.48)
"""Gaps of the signatures, mm, at the plain model's 1/E: each 30 to 100 % wider than the one before, as
responses change by shares."""
MOST_FRAMES = 30
"""Contact is solved for so many frames of a recording, evenly spaced in load; between them in a line."""
PEAK = 0.3
"""Peaks of the load above such a share of the greatest are solved for."""
LEAST_AMOUNT = 0.5
"""Set between what recordings ask for of the gap that gains most: eight sound fruit 0.44 at most, six of the
eight loose pits drawn for it, those looked at, 0.69 to 1.02. None
of these was set aside."""
MOST_ROUNDS, STILL = 12, 1e-3
"""A gap counts in units of 1/E, which is not that of the bonded model: it is fitted with it, until it changes
by a smaller share than STILL (a tenth of what E is known to)."""

SPEC = EffectSpec(
    name="loose_pit",
    rank=100,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit is loose in its hollow",
        meaning="There is a gap between flesh and pit (a freestone): the flesh gives way easily at first, "
        "until it meets the pit.",
        advice="Nothing is wrong with the fruit. Read the modulus with the gap taken out.",
    ),
    parameters=(
        number(
            GAP,
            "mm",
            "gap between flesh and pit",
            limits=(0.0, 50.0),
            low=0.005,
            high=1.0,
            log=True,
            model_share=0.2,
        ),
    ),
    of_the_pit=True,
)
"""By hand, wide: limits and bounds. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


class LoosePit(Effect):
    """The effect; see the module."""

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each gap, about a pit that turns and one that does not; none where the flesh has no pit.

        The flesh is solved for a gap over 1/E. Its own 1/E is fitted afterwards, and with it the gap in mm.
        """
        if not len(model.mesh.pit_nodes):
            return []
        signatures = []
        for pit_turns, gap_mm in product((True, False), GAPS_MM):
            try:
                unit = _responses(model, gap_mm / model.compliance, pit_turns=pit_turns)
            except FemFailure as failure:
                way = at_gap(gap_mm, pit_turns=pit_turns)
                signatures.append(Signature(variant=way, columns=(), untried=failure.detail))
                continue
            share = _fitted(model, unit) / model.compliance
            way = at_gap(significant(gap_mm * share, 3), pit_turns=pit_turns)
            more = [
                model.compliance * (loose - recording.tracks.unit_displacement)
                for recording, loose in zip(model.grasps, unit, strict=True)
            ]
            signatures.append(
                Signature.of_markers("loose", more, sd=1.0, variant=way, positive=True, least=LEAST_AMOUNT)
            )
        return signatures

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The signature's own gap: its amount is the fitted 1/E over the plain model's."""
        return self.spec.within_bounds(signature.variant.values[0])

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """Every recording's markers on flesh that touches its pit where it is pressed on it.

        Where the variant does not say whether the pit turns (ONE_WAY, of settings) both are computed, and the
        one that fits the recordings better is taken. Raises FemFailure where neither can be computed.
        """
        gap_mm = parameters[GAP]
        if variant.pit_turns is not None:
            return Response(unit=self._fixed_point(model, gap_mm, pit_turns=variant.pit_turns))
        responses: list[list[Float[np.ndarray, "_f _n 3"]]] = []
        failures: list[FemFailure] = []
        for turns in (True, False):
            try:
                responses.append(self._fixed_point(model, gap_mm, pit_turns=turns))
            except FemFailure as failure:
                failures.append(failure)
        if not responses:
            raise failures[0]
        return Response(unit=max(responses, key=lambda unit: _explained(model, unit)))

    @staticmethod
    def _fixed_point(
        model: CaseModel, gap_mm: float, *, pit_turns: bool
    ) -> list[Float[np.ndarray, "_f _n 3"]]:
        compliance = model.compliance
        for _ in range(MOST_ROUNDS):
            unit, before = _responses(model, gap_mm / compliance, pit_turns=pit_turns), compliance
            compliance = _fitted(model, unit)
            if abs(compliance / before - 1) < STILL:
                return unit
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"1/E of flesh about a pit with a gap of {gap_mm:.3g} mm still changes by "
            f"{abs(compliance / before - 1):.2%} after {MOST_ROUNDS} rounds, expected {STILL:.1%} at most",
        )


EFFECT: Effect = LoosePit(spec=SPEC)


def at_gap(gap_mm: float, *, pit_turns: bool) -> Variant:
    """A gap about the pit, from which the search starts; whether the pit turns in it."""
    label = f"gap {gap_mm:g} mm, pit {'turns' if pit_turns else 'does not turn'}"
    return Variant(label=label, values=(gap_mm,), pit_turns=pit_turns)


def _responses(model: CaseModel, gap: float, *, pit_turns: bool) -> list[Float[np.ndarray, "_f _n 3"]]:
    """Of every recording, for a gap of so many mm MPa."""
    return model.each(lambda recording: loose_response(model, recording, gap, pit_turns=pit_turns))


def loose_response(
    model: CaseModel, recording: GraspResponse, gap: float, *, pit_turns: bool
) -> Float[np.ndarray, "f n 3"]:
    """The markers' displacement, mm MPa, for a gap of so many mm MPa."""
    flesh = loose_flesh(model, recording)
    key = ("loose answer", recording.case.name)
    free, opening, pushed = model.memoised(key, lambda: flesh.marker_response(recording))
    open_by = recording.shares @ opening + gap * flesh.area_mm2
    path, frames = _spread(recording.shares)
    contact_pressure = pressures(flesh.compliance(pit_turns=pit_turns), open_by[frames])
    pressed = np.stack([np.interp(path, path[frames], course) for course in contact_pressure.T], axis=1)
    return np.asarray(recording.over_time(free) + np.tensordot(pressed, pushed, axes=(1, 0)))


def _spread(
    shares: Float[np.ndarray, "f r"],
) -> tuple[Float[np.ndarray, " f"], Int[np.ndarray, " k"]]:
    """How far the load has gone by each frame; frames evenly spaced along that, the last, and its peaks."""
    step = np.linalg.norm(np.diff(shares, axis=0), axis=1) + 1e-12
    path = np.concatenate([[0.0], np.cumsum(step)])
    even = np.searchsorted(path, np.linspace(0, path[-1], MOST_FRAMES))
    size = np.linalg.norm(shares, axis=1)
    rim = np.concatenate([[-np.inf], size, [-np.inf]])
    peaks = np.flatnonzero((size >= rim[:-2]) & (size >= rim[2:]) & (size > PEAK * size.max()))
    return path, np.union1d(even.clip(max=len(path) - 1), peaks)


def _fitted(model: CaseModel, unit: Sequence[Float[np.ndarray, "_f _n 3"]]) -> float:
    """1/E where the markers move so under the forces."""
    normal, right = _normal_equation(model, unit)
    return max(right / normal, model.compliance / 10)


def _explained(model: CaseModel, unit: Sequence[Float[np.ndarray, "_f _n 3"]]) -> float:
    """How much of the markers' chi-square such motion explains, at its best 1/E."""
    normal, right = _normal_equation(model, unit)
    return max(right, 0.0) ** 2 / normal


def _normal_equation(
    model: CaseModel, unit: Sequence[Float[np.ndarray, "_f _n 3"]]
) -> tuple[float, float]:
    """u' W u and u' W y of all recordings; their 1/E is the second over the first."""
    normal = right = 0.0
    for recording, displacement in zip(model.grasps, unit, strict=True):
        heavy = model.marker_equations(recording).weighed(displacement)
        normal += float((heavy * displacement).sum())
        right += float((heavy * (recording.tracks.position_mm - recording.tracks.place_mm)).sum())
    return normal, right
