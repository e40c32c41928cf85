import numpy as np
import pytest
from injected_presses import NU, THICK_MM, Press, injected
from press_trace import ball_trace

from fem.indentation.contact_law import Law
from fem.indentation.effects.trace_damage import DAMAGE
from fem.indentation.effects.trace_gripper_compliance import GRIPPER_COMPLIANCE
from fem.indentation.effects.trace_viscoelastic import viscoelastic
from fem.indentation.fit import fit
from fem.indentation.next_trace import PRESSES, next_press
from fem.indentation.no_contact import first_touch, no_contact_noise
from fem.indentation.trace_baseline import linear_law


@pytest.fixture(scope="module")
def short_ramp():
    """A ramp with hardly a hold, in which relaxing, damaged and compliant look alike; their fits."""
    rng = np.random.default_rng(3)
    press = Press(hold_s=0.5, unload=False)
    trace = ball_trace(*injected(rng, g=(0.3,), tau_s=(4.0,), press=press))
    air = no_contact_noise(trace, first_touch(trace))
    linear = linear_law(trace, thickness_mm=THICK_MM, poisson_ratio=NU)
    fits = []
    for effect in (viscoelastic(1), DAMAGE, GRIPPER_COMPLIANCE):
        law = Law(curve=linear.curve, baseline=linear.baseline, effects=(effect,))
        fits.append(fit(law, trace, air, np.array([[u.mean for u in law.unknowns]])))
    return trace, air, fits


def test_one_explanation_needs_no_further_press(short_ramp):
    trace, air, fits = short_ramp
    assert next_press(fits[:1], trace, air) is None


def test_relaxing_and_compliant_are_parted_by_time(short_ramp):
    trace, air, fits = short_ramp
    words = next_press([fits[0], fits[2]], trace, air)
    assert words in PRESSES
    assert "air" not in words
