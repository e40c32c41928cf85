"""Several recordings of one specimen under one law: presses of another solver at three rates."""

import numpy as np
import pytest
from injected_presses import NU, THICK_MM, Press, injected
from press_trace import ball_trace

from fem.indentation.account import account_for
from fem.indentation.heldout import whole_recordings
from fem.indentation.trace import joined
from fem.indentation.trace_baseline import linear_law


def press(seed, *, ramp_s, onset_mm, **kind):
    shape = Press(ramp_s=ramp_s, hold_s=4.0, unload=False, rate_hz=10.0, onset_mm=onset_mm)
    return ball_trace(*injected(np.random.default_rng(seed), press=shape, **kind))


def three(**kind):
    rates = ((1.0, 0.2), (4.0, 0.6), (20.0, 0.9))
    return [press(k, ramp_s=ramp, onset_mm=onset, **kind) for k, (ramp, onset) in enumerate(rates)]


def explained(traces):
    trace = joined(traces)
    return account_for(trace, thickness_mm=THICK_MM, poisson_ratio=NU, rng=np.random.default_rng(0))


@pytest.mark.slow
def test_rates_together_name_relaxation_with_one_share_time_and_modulus():
    found = explained(three(g=(0.4,), tau_s=(3.0,)))
    said = found.explanation
    top = said.ranking[0]
    assert said.verdict == "viscoelastic"
    assert top.parameters["g"].value == pytest.approx(0.4, rel=0.04)
    assert top.parameters["tau_s"].value == pytest.approx(3.0, rel=0.08)
    assert said.after.value == pytest.approx(0.3, rel=0.03)
    for name, onset in (("onset_mm", 0.2), ("onset_mm_2", 0.6), ("onset_mm_3", 0.9)):
        assert top.parameters[name].value == pytest.approx(onset, abs=0.03)
    assert said.heldout.rms_before > 3 * said.heldout.rms_after


@pytest.mark.proof
def test_linear_flesh_pressed_thrice_is_nothing_to_report():
    said = explained(three()).explanation
    assert said.verdict == "none"
    assert said.after.value == pytest.approx(0.3, rel=0.02)
    assert len({cell.grasp for cell in said.cells}) == 3


def test_one_recording_joined_is_itself():
    one = press(0, ramp_s=2.0, onset_mm=0.2)
    assert joined([one]) is one
    assert one.parts == (one,)


def test_a_joined_trace_has_each_recordings_force_and_phases():
    parts = three()
    whole = joined(parts)
    law = linear_law(whole, thickness_mm=THICK_MM, poisson_ratio=NU)
    names = [u.name for u in law.unknowns]
    own = [f"{n}{k}" for k in ("", "_2", "_3") for n in ("onset_mm", "zero_N")]
    assert names == ["E_MPa", *own, "bend", "drift_N_per_min"]
    scaled = np.array([u.mean for u in law.unknowns])
    force = law.force_N(whole, scaled[None])[0]
    second = linear_law(parts[1], thickness_mm=THICK_MM, poisson_ratio=NU)
    own = second.force_N(parts[1], scaled[[0, 3, 4, 7, 8]][None])[0]
    assert force[whole.slices[1]] == pytest.approx(own)
    assert whole.phases == tuple(phase for part in parts for phase in part.phases)
    assert (np.diff(whole.time_s) > 0).all()


def test_of_a_recording_left_out_only_its_beginning_stays():
    whole = joined(three())
    for mask, frames, part in zip(whole_recordings(whole), whole.slices, whole.parts, strict=True):
        assert not mask[: frames.start].any()
        assert not mask[frames.stop :].any()
        kept = part.force_N[~mask[frames]]
        assert kept.max() < 0.12 * part.force_N.max()
