"""Recordings that no elastic fruit explains are refused, or their modulus comes with a sentence."""

import numpy as np
import pytest
from injected_recording import (
    E_MPA,
    ball_mesh,
    found_in,
    grasp,
    own_sd_MPa,
    plain_model,
    with_pads,
)

from fem.estimation.modulus import FEWEST_MARKERS, ModulusSign
from fem.fem_failure import FemFailure, FemProblem
from fem.solid.pad_link import OFF_SKIN_MM, contact_nodes

AIR = {"episode": lambda pad: 0 * pad.episode - 1}


@pytest.mark.parametrize(
    ("changed", "modelled", "problem", "words"),
    [
        ({"force_N": lambda pad: -pad.force_N}, True, FemProblem.NO_MODULUS, "Check the signs"),
        (AIR, True, FemProblem.NO_LOAD, None),
        (AIR, False, FemProblem.NO_LOAD, None),
        ({"force_N": lambda pad: 0 * pad.force_N}, False, FemProblem.NO_LOAD, "found no force"),
    ],
    ids=["forces that pull", "no touch", "no touch has no model", "no force has no model"],
)
def test_a_grasp_that_shows_no_modulus_is_refused(changed, modelled, problem, words):
    with pytest.raises(FemFailure, match=words) as caught:
        found_in(with_pads(grasp(), **changed), plain_model() if modelled else None)
    assert caught.value.problem is problem


def only_touching(history, count):
    """The `count` markers of the first pad that touch longest stay in contact; no other ever is."""
    longest = np.argsort(-(history.pads[0].episode >= 0).sum(axis=0), kind="stable")[:count]
    chosen = np.isin(np.arange(len(history.pads[0].rest_mm)), longest)
    first = history.pads[0].name
    return with_pads(history, episode=lambda pad: np.where(chosen & (pad.name == first), pad.episode, -1))


def test_fewer_markers_than_hold_a_fruit_are_refused_and_counted():
    few = only_touching(grasp(), FEWEST_MARKERS - 1)
    with pytest.raises(FemFailure, match=r"found 5 markers under load, expected at least 6") as caught:
        found_in(few, plain_model())
    assert caught.value.problem is FemProblem.TOO_FEW_MARKERS
    assert "Press deeper" in caught.value.detail
    assert found_in(only_touching(grasp(), FEWEST_MARKERS), plain_model()).E_MPa > 0


def test_a_pad_off_the_mesh_is_refused_with_how_far_it_is():
    off = OFF_SKIN_MM + 1.5
    away = with_pads(grasp(), surface_mm=lambda pad: pad.surface_mm * (1 + off / 25.0))
    for refused in (lambda: contact_nodes(ball_mesh(), [away]), lambda: found_in(away)):
        with pytest.raises(FemFailure, match=r"the worst .*4\.[45]\d mm.*Check the pad's pose") as caught:
            refused()
        assert caught.value.problem is FemProblem.OFF_SURFACE


def test_a_gain_of_one_pad_is_said():
    uneven = with_pads(grasp(), force_N=lambda pad: (1.15 if pad.name == "left" else 1.0) * pad.force_N)
    estimate = found_in(uneven, plain_model())
    assert any(warning.sign is ModulusSign.UNBALANCED for warning in estimate.warnings)


def test_a_lag_of_the_forces_is_said_and_widens_the_error_bar():
    history = grasp()
    late = with_pads(history, force_N=lambda pad: np.concatenate([pad.force_N[:1], pad.force_N[:-1]]))
    plain, lagging = found_in(history, plain_model()), found_in(late, plain_model())
    assert lagging.warnings
    assert own_sd_MPa(lagging) > 3 * own_sd_MPa(plain)


def test_frames_that_share_no_marker_are_refused():
    history = grasp(noise=0.1, surface_mm=0.0)

    def apart(pad):
        even = np.arange(len(pad.rest_mm)) % 2 == 0
        episode = np.full(pad.episode.shape, -1)
        episode[4, even & (pad.episode[4] >= 0)] = 0
        episode[5, ~even & (pad.episode[5] >= 0)] = 0
        return episode

    with pytest.raises(FemFailure, match="found 0 markers that stay in contact for two frames") as caught:
        found_in(with_pads(history, episode=apart), plain_model())
    assert caught.value.problem is FemProblem.TOO_FEW_MARKERS


def test_a_pad_seen_in_one_frame_only_leaves_the_other_its_say():
    def once(pad):
        last = np.arange(len(pad.episode))[:, None] == 5
        return np.where(last | (pad.name == "left"), pad.episode, -1)

    assert found_in(with_pads(grasp(noise=0.1), episode=once)).E_MPa == pytest.approx(E_MPA, rel=0.05)
