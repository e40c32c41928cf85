"""Springs in series with Hertz: what a rig does to E of a trace, and when it is only a lower bound."""

import numpy as np
import pytest

from fem.fem_failure import FemFailure
from fem.indentation.ball import Ball
from fem.indentation.explain_trace import explain_trace
from fem.indentation.rig_share import MOST_SHARE, SOFT_RIG_N_PER_MM, rig_share
from fem.indentation.trace import IndenterTrace

RADIUS_MM, NU = 5.0, 0.45


def hertz_mm(force_N, E_MPa):
    return (np.maximum(force_N, 0) * 3 * (1 - NU**2) / (4 * E_MPa * np.sqrt(RADIUS_MM))) ** (2 / 3)


def pressed(rig_N_per_mm, *, E_MPa=0.5, peak_N=4.0, taken_off=False, share=0.05, wrong=1.0):
    """A press into E on a linear rig; `taken_off`: its give times `wrong`, with this share as its spread."""
    rng = np.random.default_rng(0)
    force = np.r_[np.zeros(25), np.linspace(0, 1, 100) ** 1.5 * peak_N, np.full(15, peak_N)]
    travel = hertz_mm(force, E_MPa) + force / rig_N_per_mm
    travel[:25] = np.linspace(-0.2, -0.01, 25)
    give = wrong * force / rig_N_per_mm
    return IndenterTrace(
        time_s=np.arange(len(force)) / 10,
        force_N=force + 0.004 * rng.standard_normal(len(force)),
        travel_mm=travel - give if taken_off else travel,
        geometry=Ball(radius_mm=RADIUS_MM),
        rig_give_mm=give if taken_off else None,
        rig_sd_mm=share * give if taken_off else None,
    )


def explained(trace, **how):
    rng = np.random.default_rng(0)
    return explain_trace(trace, thickness_mm=None, poisson_ratio=NU, rng=rng, **how).explanation


def test_slopes_are_those_of_springs_in_series():
    force = np.linspace(2, 4, 200)
    object_mm_per_N = np.polyfit(force, hertz_mm(force, 0.5), 1)[0]
    share = rig_share(pressed(10.0, taken_off=True), rig_N_per_mm=None)
    assert share.rig_mm_per_N == pytest.approx(0.1, rel=0.01)
    assert share.rig_sd_mm_per_N == pytest.approx(0.005, rel=0.05)
    assert share.recorded_mm_per_N - share.rig_mm_per_N == pytest.approx(object_mm_per_N, rel=0.05)
    assert share.bound is None


def test_E_is_a_lower_bound_where_the_object_is_within_the_rigs_spread():
    soft = rig_share(pressed(5.0, E_MPa=0.5, taken_off=True), rig_N_per_mm=None)
    hard = rig_share(pressed(5.0, E_MPa=500.0, taken_off=True), rig_N_per_mm=None)
    assert soft.bound is None
    assert hard.bound is not None
    assert "the rig gives 0.2 ± 0.01 mm/N" in hard.bound


def test_a_stated_stiffness_is_a_bound_by_its_share():
    trace = pressed(5.0, E_MPa=500.0)
    assert "of a rig of" not in str(rig_share(trace, rig_N_per_mm=1000.0).bound)
    assert rig_share(trace, rig_N_per_mm=1000.0).bound is None
    bound = rig_share(trace, rig_N_per_mm=5.0).bound
    assert bound is not None
    assert "on a rig of 5 N/mm" in bound
    assert "too low by about" in rig_share(trace, rig_N_per_mm=25.0).notes[0]


def test_with_nothing_known_soft_contacts_raise_no_alarm_and_stiff_ones_say_what_rig_they_need():
    soft = rig_share(pressed(1e6, E_MPa=0.1, peak_N=1.0), rig_N_per_mm=None)
    assert 1 / soft.recorded_mm_per_N < MOST_SHARE * SOFT_RIG_N_PER_MM
    assert (soft.bound, soft.notes) == (None, ())
    stiff = rig_share(pressed(5.0, E_MPa=500.0), rig_N_per_mm=None)
    assert stiff.bound is None
    assert "E holds on a rig of 49 N/mm or more" in stiff.notes[0] or "of 50 N/mm" in stiff.notes[0]


@pytest.mark.slow
def test_the_interval_of_E_holds_the_rigs_error():
    sure = explained(pressed(4.0, taken_off=True, share=0.005))
    off = explained(pressed(4.0, taken_off=True, share=0.1, wrong=1.1))
    assert abs(sure.before.value - 0.5) < 1.645 * sure.before.sd
    assert abs(off.before.value - 0.5) > 0.03
    assert abs(off.before.value - 0.5) < 1.645 * off.before.sd
    assert off.before.sd > 3 * sure.before.sd


@pytest.mark.slow
def test_a_lower_bound_is_said_in_place_of_E_and_lies_below_the_truth():
    said = explained(pressed(4.0, E_MPa=100.0, peak_N=10.0, taken_off=True, share=0.1))
    assert np.isnan(said.after.value)
    assert all(candidate.modulus is None for candidate in said.ranking)
    least = float(said.withheld.split("at least ")[1].split()[0])
    assert 0.5 < least < 100.0
    stated = explained(pressed(4.0, E_MPa=100.0, peak_N=10.0), rig_N_per_mm=4.0)
    assert float(stated.withheld.split("at least ")[1].split()[0]) < 100.0


def test_a_give_that_is_no_number_a_frame_is_refused():
    with pytest.raises(FemFailure, match="rig_sd_mm"):
        IndenterTrace(
            time_s=np.arange(30.0),
            force_N=np.zeros(30),
            travel_mm=np.arange(30.0),
            geometry=Ball(radius_mm=5.0),
            rig_give_mm=np.zeros(30),
            rig_sd_mm=np.full(30, np.nan),
        )
