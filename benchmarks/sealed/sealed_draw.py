"""The cases of the sealed proof: what each holds follows from the salt and from `samples/` alone.

Fruit, category, sensor and scan are drawn as for the bank (samples.mismatch); amplitudes log-uniformly over
AMPLITUDES of samples.mismatch.effect_levels. Cases are numbered in an order in which any first part is a fair
sample: kinds in their shares, effects in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sealing import seed_of

from samples.mismatch.case_files import answer
from samples.mismatch.case_simulation import CasePlan, label_of_plan, planned
from samples.mismatch.drawn_fruit import CATEGORIES, DrawnFruit, drawn_fruit, seen_by_drawn_sensor
from samples.mismatch.effect_levels import Amplitude, drawn_amplitude
from samples.mismatch.four_grasps import four_grasps

SOUND, SINGLE, PAIR, OUTSIDE = "sound", "single", "pair", "outside"
SHARES = {SOUND: 60, SINGLE: 100, PAIR: 20, OUTSIDE: 20}
"""Cases of each kind, of 200 (set by hand; the errors of the shares printed follow from them)."""
LAWS = ("linear", "neo-hookean")
"""Of sound fruit when the labels were sealed. All flesh is Neo-Hookean today, whatever a label says."""
ATTEMPTS = 2
"""Draws of a case, of which the first that finds its balance counts; all of them are sealed."""
PAIR_ABOVE = 0.6
"""Amplitudes of pairs are drawn from this share of the logarithm of their range on: both plain (set by
hand)."""
SINGLES = (
    "viscoelastic", "stiffening", "skin", "graded_modulus", "soft_spot", "anisotropy", "poisson_ratio",
    "pit_offset", "pit_size", "loose_pit", "slip", "plastic_set", "damage", "sensor_gain", "sensor_drift",
    "gripper_compliance", "clock_lag", "pose_error", "adhesion", "sensor_nonlinear", "gel_creep",
    "gel_hysteresis", "thermal_drift",
)  # fmt: skip
OUTSIDERS = ("split_pit", "palm", "gel_softening", "drainage")
"""Effects and physics outside the catalogue as they stood when the manifest was drawn: lists of their own, so
that what `samples/` learns later draws no other cases."""
ONE_LAW = ("stiffening", "plastic_set", "damage", "viscoelastic", "loose_pit")
"""Effects of which no two are simulated together (samples.mismatch.case_simulation.body_of)."""


@dataclass(frozen=True, kw_only=True)
class SealedCase:
    """One case: its number, which says nothing, its kind, and what decides all the rest."""

    case_id: str
    kind: str
    effects: tuple[tuple[str, Amplitude], ...] = ()
    physics: str | None = None
    salt: str

    def seed(self, attempt: int) -> tuple[int, ...]:
        """Of one attempt at the case."""
        return seed_of(self.salt, self.case_id, attempt)


def drawn_cases(salt: str, shares: dict[str, int] | None = None) -> tuple[SealedCase, ...]:
    """All cases in their order."""
    rng = np.random.default_rng(seed_of(salt, "cases"))
    shares = SHARES if shares is None else shares
    placed: list[tuple[float, dict[str, Any]]] = []
    for kind, count in shares.items():
        own = _of_kind(kind, count, rng)
        places = (np.arange(count) + rng.uniform()) / count
        placed += [(float(place), {"kind": kind, **one}) for place, one in zip(places, own, strict=True)]
    placed.sort(key=lambda pair: pair[0])
    return tuple(
        SealedCase(case_id=f"case-{k + 1:03d}", salt=salt, **one) for k, (_, one) in enumerate(placed)
    )


def _of_kind(kind: str, count: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    if kind == SOUND:
        return [{}] * count
    if kind == OUTSIDE:
        return [{"physics": name} for name in _in_turn(OUTSIDERS, count, rng)]
    if kind == SINGLE:
        return [{"effects": ((one, drawn_amplitude(one, rng)),)} for one in _in_turn(SINGLES, count, rng)]
    found: list[dict[str, Any]] = []
    while len(found) < count:
        two = sorted(str(one) for one in rng.choice(SINGLES, 2, replace=False))
        if sum(one in ONE_LAW for one in two) < 2:
            found.append(
                {"effects": tuple((one, drawn_amplitude(one, rng, above=PAIR_ABOVE)) for one in two)}
            )
    return found


def _in_turn(names: Sequence[str], count: int, rng: np.random.Generator) -> list[str]:
    """Every name as often as any other but for one, shuffled round by round."""
    rounds = -(-count // len(names))
    return [names[int(k)] for _ in range(rounds) for k in rng.permutation(len(names))][:count]


def plan_of(case: SealedCase, attempt: int) -> CasePlan:
    """What is simulated for a case."""
    if case.kind == SOUND:
        drawn, _, rng = sound_draw(case, attempt)
        grasps = four_grasps(drawn.fruit.skin, depth_mm=drawn.depth_mm, rng=rng)
        return CasePlan(case_id=case.case_id, drawn=drawn, grasps=grasps, injected=())
    return planned(case.case_id, case.effects, seed=case.seed(attempt), out_of_catalogue=case.physics)


def sound_draw(case: SealedCase, attempt: int) -> tuple[DrawnFruit, str, np.random.Generator]:
    """The fruit of a sound case, its law, and the generator that its grasps are drawn from."""
    rng = np.random.default_rng(list(case.seed(attempt)))
    category = CATEGORIES[int(rng.integers(len(CATEGORIES)))]
    drawn = seen_by_drawn_sensor(drawn_fruit(case.case_id, category=category, rng=rng), rng)
    return drawn, LAWS[int(rng.integers(len(LAWS)))], rng


def truth_of(case: SealedCase, attempt: int) -> dict[str, Any]:
    """What an attempt holds: effect and parameters, the fruit, and the amplitude of each effect.

    Drifts are shares of the peak force here, which only the simulation knows.
    """
    plan = plan_of(case, attempt)
    return {
        **answer(plan.drawn, label_of_plan(plan, plan.injected)),
        "law": sound_draw(case, attempt)[1] if case.kind == SOUND else "linear",
        "amplitudes": {name: one.value for name, one in case.effects},
        "sensor": plan.drawn.sensor.name,
    }


def label_of(case: SealedCase) -> dict[str, Any]:
    """What is sealed."""
    return {
        "case": case.case_id,
        "kind": case.kind,
        "attempts": [truth_of(case, attempt) for attempt in range(ATTEMPTS)],
    }
