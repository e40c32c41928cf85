"""The draw follows from the salt alone, in fair order, and its cases can be simulated."""

from collections import Counter

import numpy as np
import pytest
from sealed_truths import put_on_path

put_on_path()
from sealed_draw import ONE_LAW, SHARES, SINGLES, drawn_cases, label_of, plan_of  # noqa: E402
from sealing import canonical  # noqa: E402

from samples.mismatch.effect_levels import AMPLITUDES, Amplitude, drawn_amplitude, drawn_parameters  # noqa: E402

SALT = "5a" * 32
CASES = drawn_cases(SALT)


def test_shares_are_as_said_and_any_first_part_is_fair():
    assert Counter(one.kind for one in CASES) == SHARES
    for count in (20, 50, 130):
        part = Counter(one.kind for one in CASES[:count])
        assert all(abs(part[kind] - count * share / 200) <= 1 for kind, share in SHARES.items())


def test_every_effect_comes_as_often_as_any_other():
    counts = Counter(one.effects[0][0] for one in CASES if one.kind == "single")
    assert set(counts) == set(SINGLES)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_no_pair_needs_two_laws_of_the_flesh():
    for one in CASES:
        assert sum(name in ONE_LAW for name, _ in one.effects) < 2


def test_another_salt_draws_other_cases():
    other = drawn_cases("5b" * 32)
    assert [one.effects for one in other] != [one.effects for one in CASES]
    assert label_of(other[0]) != label_of(CASES[0])


def test_a_label_is_the_same_whenever_it_is_drawn_and_carries_the_plan():
    case = next(one for one in CASES if one.kind == "single")
    label = label_of(case)
    assert canonical(label) == canonical(label_of(case))
    truth, plan = label["attempts"][0], plan_of(case, 0)
    assert truth["effect"] == plan.injected[0].effect == case.effects[0][0]
    assert truth["E_MPa"] == plan.drawn.fruit.E_MPa
    assert label["attempts"][1]["E_MPa"] != truth["E_MPa"]


def test_a_sound_case_has_no_amplitude_and_a_law_of_its_own():
    laws = {label_of(one)["attempts"][0]["law"] for one in CASES if one.kind == "sound"}
    assert laws == {"linear", "neo-hookean"}


@pytest.mark.parametrize("effect", SINGLES)
def test_amplitudes_are_even_in_their_logarithm_and_become_parameters(effect):
    rng = np.random.default_rng(1)
    drawn = [drawn_amplitude(effect, rng).value for _ in range(400)]
    low, high = AMPLITUDES[effect]
    assert low <= min(drawn) < max(drawn) <= high
    assert np.median(drawn) == pytest.approx(np.sqrt(low * high), rel=0.25)
    assert drawn_parameters(effect, Amplitude(drawn[0]), rng)


@pytest.mark.parametrize(
    ("effect", "amplitude", "name", "value"),
    [("soft_spot", 0.3, "ratio", 0.7), ("slip", 5.0, "mu", 0.2), ("plastic_set", 10.0, "yield_over_E", 0.1)],
)
def test_an_amplitude_counts_from_no_effect(effect, amplitude, name, value):
    parameters = drawn_parameters(effect, Amplitude(amplitude), np.random.default_rng(0))
    assert parameters[name] == pytest.approx(value)


def test_poisson_ratio_is_off_by_its_amplitude_and_never_beyond_what_bricks_bear():
    rng = np.random.default_rng(0)
    small = {round(drawn_parameters("poisson_ratio", Amplitude(0.02), rng)["nu"], 3) for _ in range(20)}
    large = {round(drawn_parameters("poisson_ratio", Amplitude(0.1), rng)["nu"], 3) for _ in range(20)}
    assert small == {0.43, 0.47}
    assert large == {0.35}
