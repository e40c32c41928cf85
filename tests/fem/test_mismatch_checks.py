"""Checks of a recording: their numbers in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.mismatch.result import GraspTrace
from fem.mismatch.selection.predictive_checks import checks

FORCE = np.array([0.0, 1.0, 2.0, 2.0, 2.0, 1.0, 0.0])
PHASE = ("load",) * 3 + ("hold",) * 2 + ("unload",) * 2
LINEAR = 0.5 * FORCE
CREPT = LINEAR + np.array([0.0, 0.0, 0.0, 0.1, 0.2, 0.2, 0.2])


def of(given: np.ndarray, after: np.ndarray, lag1: float = 0.0) -> dict:
    trace = GraspTrace(
        grasp="grasp-1",
        time_s=np.arange(7.0),
        phase=PHASE,
        force_N=FORCE,
        given_mm=given,
        before_mm=LINEAR,
        after_mm=after,
    )
    tracks = SimpleNamespace(
        sd_mm=np.full(25, 0.004), lag1=np.full(25, lag1), episode=np.zeros((7, 25), dtype=int)
    )
    compared = checks([trace], [SimpleNamespace(tracks=tracks)], rng=np.random.default_rng(0))
    return {check.name.removeprefix("grasp-1: "): check for check in compared}


def test_creep_and_loop_of_a_trace_that_creeps_under_a_load_that_stands_still():
    by_name = of(CREPT, CREPT)
    assert by_name["approach at half the load"].measured == pytest.approx(0.5)
    assert by_name["creep in the hold"].measured == pytest.approx(0.1)
    assert by_name["creep in the hold"].before == pytest.approx(0.0)
    # by parts: the integral of F dx is 2 N times the .2 mm crept
    assert by_name["loop area"].measured == pytest.approx(0.4)
    assert by_name["loop area"].before == pytest.approx(0.0)


def test_the_spread_is_that_of_the_mean_of_the_markers():
    sd = of(CREPT, CREPT)["creep in the hold"].sd
    assert sd == pytest.approx(np.sqrt(2) * 0.004 / 5, rel=0.25)


def test_noise_that_changes_slowly_moves_neighbouring_frames_together():
    sd = of(CREPT, CREPT, lag1=0.8)["creep in the hold"].sd
    assert sd == pytest.approx(np.sqrt(2 * (1 - 0.8)) * 0.004 / 5, rel=0.25)


def test_what_a_recording_lacks_is_not_asked():
    trace = GraspTrace(
        grasp="g",
        time_s=np.arange(3.0),
        phase=("load",) * 3,
        force_N=FORCE[:3],
        given_mm=LINEAR[:3],
        before_mm=LINEAR[:3],
        after_mm=LINEAR[:3],
    )
    tracks = SimpleNamespace(sd_mm=np.full(4, 0.004), lag1=np.zeros(4), episode=np.zeros((3, 4), dtype=int))
    compared = checks([trace], [SimpleNamespace(tracks=tracks)], rng=np.random.default_rng(0))
    assert [check.name for check in compared] == ["g: approach at half the load"]
