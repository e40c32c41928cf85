import numpy as np
import pytest
from injected_presses import NU, THICK_MM, Press, injected
from press_trace import ball_trace

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.explain_trace import explain_trace


def explained(columns, *, thickness_mm=THICK_MM, nu=NU):
    trace = ball_trace(*columns)
    return explain_trace(trace, thickness_mm=thickness_mm, poisson_ratio=nu, rng=np.random.default_rng(0))


def test_linear_flesh_is_nothing_to_report():
    said = explained(injected(np.random.default_rng(1), press=Press(rate_hz=5.0)))
    assert said.verdict == "none"
    assert not said.detected
    assert said.before.value == pytest.approx(0.3, rel=0.02)
    assert abs(said.after.value - said.before.value) < said.before.sd


def test_relaxing_flesh_is_named_with_its_share_its_time_and_its_modulus():
    said = explained(
        injected(np.random.default_rng(2), g=(0.4,), tau_s=(5.0,), press=Press(rate_hz=5.0, onset_mm=1.0))
    )
    top = said.ranking[0]
    assert said.verdict == top.effect == "viscoelastic"
    assert said.p_value < 1e-6
    assert top.parameters["g"].value == pytest.approx(0.4, rel=0.04)
    assert top.parameters["tau_s"].value == pytest.approx(5.0, rel=0.08)
    assert top.parameters["onset_mm"].value == pytest.approx(1.0, abs=0.02)
    assert said.after.value == pytest.approx(0.3, rel=0.03)
    assert said.heldout.rms_before > 5 * said.heldout.rms_after
    assert any("Contact starts late: 1.0" in note for note in said.notes)
    assert sum(c.probability for c in said.ranking) > 0.95


@pytest.mark.proof
def test_two_effects_at_work_are_named_together():
    said = explained(
        injected(
            np.random.default_rng(3),
            law="stiffening b=8",
            g=(0.4,),
            tau_s=(4.0,),
            noise_N=0.002,
            press=Press(unload=False, rate_hz=5.0),
        )
    )
    assert said.verdict == "stiffening+viscoelastic"


@pytest.mark.proof
@pytest.mark.parametrize(
    ("injecting", "name"),
    [
        ({"law": "damage dmax=0.5 W0_over_E=0.01"}, "damage"),
        ({"law": "plastic_set yield_over_E=0.1"}, "plastic_set"),
        ({"newton_per_s": 0.006}, "sensor_drift"),
    ],
)
def test_an_effect_of_another_solver_is_named(injecting, name):
    said = explained(injected(np.random.default_rng(4), press=Press(rate_hz=5.0), **injecting))
    assert said.verdict == name
    assert said.where.region == ("tip" if name == "sensor_drift" else "flesh")


def test_what_no_effect_explains_is_unknown():
    time_s, force_N, travel_mm = injected(np.random.default_rng(5), press=Press(rate_hz=5.0))
    said = explained((time_s, force_N * (1 + 0.3 * np.sin(5 * travel_mm)), travel_mm))
    assert said.verdict == "unknown"
    assert said.withheld is not None


def failure_of(columns, **kind):
    with pytest.raises(FemFailure) as caught:
        explained(columns, **kind)
    return caught.value


@pytest.mark.usefixtures("unchecked_shapes")
def test_refusals_say_what_was_found_and_what_to_do():
    time, force, travel = injected(np.random.default_rng(6))
    back = time.copy()
    back[10] = back[9]
    assert "strictly increasing" in failure_of((back, force, travel)).detail
    assert "forces" in failure_of((time, force[1:], travel)).detail
    assert "not finite" in failure_of((time, np.where(time > 5, np.nan, force), travel)).detail
    assert "at least 20" in failure_of((time[:9], force[:9], travel[:9])).detail
    assert failure_of((time, force, travel), nu=0.5).problem is FemProblem.BAD_POISSON_RATIO
    assert "thickness -1" in failure_of((time, force, travel), thickness_mm=-1.0).detail
    noise = np.random.default_rng(7).standard_normal(len(time))
    assert failure_of((time, noise, travel)).problem is FemProblem.NO_LOAD
    assert "more slowly where the machine" in failure_of((time, noise, travel)).detail
    nothing = np.zeros(len(time))
    assert "found a force of 0 N in every frame" in failure_of((time, nothing, travel)).detail
    assert "another column taken for the travel" in failure_of((time, force, nothing)).detail
