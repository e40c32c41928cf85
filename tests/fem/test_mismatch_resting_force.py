"""What a pad feels in the air: a drift is told from noise and memory, whoever else is in the recording."""

from dataclasses import replace

import numpy as np
import pytest
from injected_mismatch import FLAT, TIME_S, injected_case, linear_and_refitted, on_pad, only_grasp

from fem.estimation.zero_drift import REMEMBERED, zero_drift
from fem.grasp_history import GraspHistory
from fem.mismatch.effects import sensor_drift
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.signature_variant import of_pad

AIR_S, AFTER = TIME_S[:3].mean(), 5
E_MPA = 0.25


def let_go(case: MismatchCase, newton_per_s: float) -> MismatchCase:
    """One recording that goes on in the air, its right pad's sensor drifting from the first frame on."""
    (grasp,) = only_grasp(case, 0).grasps
    history = grasp.history
    time = np.concatenate([history.time_s, history.time_s[-1] + 0.25 * np.arange(1, AFTER + 1)])
    rng = np.random.default_rng(3)
    pads = []
    for pad, motion in zip(history.pads, grasp.pads, strict=True):
        normal = motion.pose[0, :3, 2]
        grown = newton_per_s * (time - AIR_S) / len(FLAT) * (pad.name == "right")
        more = {
            name: np.concatenate([getattr(pad, name), np.repeat(getattr(pad, name)[:1], AFTER, axis=0)])
            for name in ("position_mm", "gel_displacement_mm", "force_N", "episode")
        }
        more["force_N"][-AFTER:] = pad.force_sd_N * rng.normal(size=more["force_N"][-AFTER:].shape)
        more["force_N"] = more["force_N"] + grown[:, None, None] * normal
        pads.append(replace(pad, **more))
    motions = tuple(
        replace(
            motion,
            pose=np.concatenate([motion.pose, np.repeat(motion.pose[:1], AFTER, axis=0)]),
            normal_N=np.concatenate([motion.normal_N, np.zeros(AFTER)]),
        )
        for motion in grasp.pads
    )
    phase = (*history.phase, *("air",) * AFTER)
    history = replace(history, time_s=time, phase=phase, pads=tuple(pads))
    return replace(case, grasps=(replace(grasp, history=history, pads=motions),))


def felt(history: GraspHistory, case: MismatchCase, pad: int):
    return zero_drift(history, pad, case.grasps[0].pads[pad].pose[0, :3, 2])


def test_a_drift_is_measured_in_the_air_on_its_own_pad_alone():
    case = let_go(injected_case(on_pad("right", lambda pad: pad)), 0.05)
    left, right = (felt(case.grasps[0].history, case, pad) for pad in (0, 1))
    assert right.sure
    assert right.rate_N_per_s == pytest.approx(0.05, abs=3 * right.sd_N_per_s)
    assert not left.sure
    assert abs(left.rate_N_per_s) < 3 * left.sd_N_per_s


def test_what_a_gel_may_remember_is_no_drift():
    case = let_go(injected_case(on_pad("right", lambda pad: pad)), 0.0)
    history = case.grasps[0].history
    right = history.pads[1]
    peak = np.abs((right.force_N @ case.grasps[0].pads[1].pose[0, :3, 2]).sum(axis=1)).max()
    kept = right.force_N.copy()
    kept[-AFTER:] += REMEMBERED * peak / len(FLAT) * case.grasps[0].pads[1].pose[0, :3, 2]
    assert not felt(replace(history, pads=(history.pads[0], replace(right, force_N=kept))), case, 1).sure


def test_without_frames_after_the_contact_nothing_is_said():
    case = only_grasp(injected_case(on_pad("right", lambda pad: pad)), 0)
    assert felt(case.grasps[0].history, case, 1) is None


def test_a_drift_that_markers_noise_hides_is_found_by_its_size_and_taken_out_of_the_modulus():
    rate = 0.02  # half a millinewton on a marker at the end, half its noise
    model, linear, again = linear_and_refitted(
        let_go(injected_case(on_pad("right", lambda pad: pad)), rate), sensor_drift.EFFECT
    )
    assert again.variants == (of_pad("right"),)
    assert again.parameters[0]["newton_per_s"] == pytest.approx(rate, rel=0.1)
    assert linear.best[0].gain > 10
    assert modulus_of(model, again.response).value == pytest.approx(E_MPA, rel=0.03)
