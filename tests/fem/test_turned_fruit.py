"""A fruit that turns between its pads, by the exact rotation of its flesh and of the forces on it."""

from dataclasses import replace

import numpy as np
import pytest
from injected_mismatch import E_MPA, NOISE_MM, TIME_S, injected_case, only_grasp, pads_under
from plain_model import plain_forward_model, screened_effects
from scipy.spatial.transform import Rotation

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence import nuisances
from fem.mismatch.evidence.large_deformation import (
    LARGE_DEFORMATION,
    large_deformation,
    leave_large_deformation,
)
from fem.mismatch.evidence.turned_fruit import TURNED_FRUIT, from_first_loading, turned_fruit
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.selection import screening
from fem.mismatch.selection.retained_columns import retained_columns
from fem.mismatch.selection.screening import LinearRound

POSE_ERROR = next(effect for effect in EFFECTS if effect.spec.name == "pose_error")
TURN_RAD = np.interp(TIME_S, [2.0, 3.0], [0.0, np.radians(4.0)])[:, None] * np.array([0.0, 0.8, 0.6])
"""From the greatest load on, about an axis across the jaws."""


def turned_case(turn_rad: np.ndarray) -> MismatchCase:
    """One grasp, y = Q (X + C Q'f / E), forces as recorded."""
    turn = Rotation.from_rotvec(turn_rad)

    def turned_back(force: np.ndarray) -> np.ndarray:
        return np.stack([q.inv().apply(frame_force) for q, frame_force in zip(turn, force, strict=True)])

    case = only_grasp(injected_case(), 0)
    grasp, rng = case.grasps[0], np.random.default_rng(1)
    pads = []
    for pad, true in zip(grasp.history.pads, pads_under(turned_back)[0], strict=True):
        body = true.place_mm + true.unit / E_MPA
        position = np.stack([q.apply(frame_body) for q, frame_body in zip(turn, body, strict=True)])
        noise = NOISE_MM * rng.normal(size=position.shape)
        pads.append(replace(pad, position_mm=position + noise))
    return replace(case, grasps=(replace(grasp, history=replace(grasp.history, pads=tuple(pads))),))


def looked_at(case: MismatchCase) -> LinearRound:
    """The linear round with pose errors alone; flesh that moves little."""
    forward, _ = plain_forward_model(case)
    leave_large_deformation(forward)
    with pytest.MonkeyPatch.context() as patch:  # the forces are exact: no model error stands for the turn
        patch.setattr(screening, "model_error_columns", lambda *_, **__: [])
        return screened_effects(forward, [POSE_ERROR])


@pytest.mark.slow
def test_what_a_turn_adds_is_there_in_full_and_is_no_pose_error(monkeypatch):
    case = turned_case(TURN_RAD)
    linear = looked_at(case)
    columns = [linear.products.columns[j] for j in linear.null.chosen]
    (place,) = (k for k, column in enumerate(columns) if column.name == TURNED_FRUIT)
    share = columns[place].mean + linear.null.amounts[place]
    monkeypatch.setattr(nuisances, "turned_fruit", lambda *_: None)
    without = looked_at(case)
    assert share == pytest.approx(1.0, abs=0.1)
    assert linear.best[0].gain < 3
    assert without.best[0].gain > 100


def test_who_takes_large_deformation_in_takes_the_turn_in_too():
    forward, _ = plain_forward_model(turned_case(TURN_RAD))
    (recording,) = forward.base.grasps
    (column,) = (
        nuisance for nuisance in nuisances.common_nuisances(forward) if nuisance.name == LARGE_DEFORMATION
    )
    (flesh,), turn = large_deformation(forward), turned_fruit(forward, recording)
    np.testing.assert_allclose(column.fields[0].markers, forward.compliance * flesh + turn, rtol=1e-12)
    (alone,) = nuisances.stand_ins(forward)
    assert (alone.name, alone.stands_in) == (TURNED_FRUIT, True)
    np.testing.assert_array_equal(alone.fields[0].markers, turn)


def test_beside_a_law_that_holds_large_deformation_the_turn_stands_alone():
    columns = [
        Regressor(name=name, sd=1.0, fields=(), stands_in=name == TURNED_FRUIT)
        for name in ("1/E", "dent", LARGE_DEFORMATION, TURNED_FRUIT, "b")
    ]
    known = (1, 2)
    stiffening = next(effect for effect in EFFECTS if effect.spec.name == "stiffening")
    assert retained_columns([stiffening], columns, known) == (1, 3)
    assert retained_columns([POSE_ERROR], columns, known) == known


def test_nothing_is_added_where_the_fruit_does_not_turn():
    forward, _ = plain_forward_model(only_grasp(injected_case(), 0))
    assert turned_fruit(forward, forward.base.grasps[0]) is None


def test_a_held_fruit_does_not_turn():
    case = turned_case(TURN_RAD)
    held = replace(case, grasps=(replace(case.grasps[0], support="base"),))
    forward, _ = plain_forward_model(held)
    assert turned_fruit(forward, forward.base.grasps[0]) is None


def test_turns_count_from_the_first_loading_of_each_contact():
    # as they are seen: about the mean of each contact
    contact = np.repeat([0, -1, 1], [4, 1, 4])
    load = np.array([0.3, 0.6, 1.0, 0.5, 0.0, 0.2, 0.5, 0.9, 0.4])
    true = np.array([0.0, 0.0, 0.02, 0.02, 0.0, 0.01, 0.01, 0.05, 0.05])
    seen = true.copy()
    for number in (0, 1):
        seen[contact == number] -= true[contact == number].mean()
    turns = from_first_loading(seen[:, None] * np.eye(3)[0], load, contact)
    np.testing.assert_allclose(turns[:, 0], [0.0, 0.0, 0.02, 0.02, 0.0, 0.0, 0.0, 0.04, 0.04], atol=1e-12)
