"""A fruit that turns between its pads, by the exact rotation of its flesh and of the forces on it."""

from dataclasses import replace

import numpy as np
import pytest
from injected_mismatch import E_MPA, NOISE_MM, TIME_S, injected_case, only_grasp, pads_under
from plain_model import case_model, screened_effects
from scipy.spatial.transform import Rotation

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence import beyond_small_strain
from fem.mismatch.evidence.beyond_small_strain import (
    LARGE_DEFORMATION,
    TURNED_FRUIT,
    displacement_beyond,
    from_first_loading,
    large_deformation,
    turned_fruit,
)
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.selection import screening
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
    model, _ = case_model(case)
    with pytest.MonkeyPatch.context() as patch:  # the forces are exact: no model error stands for the turn
        patch.setattr(screening, "model_error_columns", lambda *_, **__: [])
        for module in (screening, beyond_small_strain):
            patch.setattr(module, "large_deformation", lambda _: [])
        return screened_effects(model, [POSE_ERROR])


@pytest.mark.slow
def test_what_a_turn_adds_is_there_in_full_and_is_no_pose_error(monkeypatch):
    case = turned_case(TURN_RAD)
    linear = looked_at(case)
    columns = [linear.products.columns[j] for j in linear.null.chosen]
    (place,) = (k for k, column in enumerate(columns) if column.name == TURNED_FRUIT)
    share = columns[place].mean + linear.null.amounts[place]
    monkeypatch.setattr(beyond_small_strain, "turned_fruit", lambda *_: None)
    without = looked_at(case)
    assert share == pytest.approx(1.0, abs=0.1)
    assert linear.best[0].gain < 3
    assert without.best[0].gain > 100


def test_markers_move_by_large_deformation_and_by_the_turn():
    model, _ = case_model(turned_case(TURN_RAD))
    columns = beyond_small_strain.beyond_small_strain(model)
    assert [column.name for column in columns] == [LARGE_DEFORMATION, TURNED_FRUIT]
    (flesh,), turn = large_deformation(model), turned_fruit(model, model.grasps[0])
    (both,) = displacement_beyond(model)
    (alone,) = displacement_beyond(model, large_deformation=False)
    np.testing.assert_allclose(both, model.compliance * flesh + turn, rtol=1e-12)
    np.testing.assert_array_equal(alone, turn)


def test_nothing_is_added_where_the_fruit_does_not_turn():
    model, _ = case_model(only_grasp(injected_case(), 0))
    assert turned_fruit(model, model.grasps[0]) is None


def test_a_held_fruit_does_not_turn():
    case = turned_case(TURN_RAD)
    held = replace(case, grasps=(replace(case.grasps[0], support="base"),))
    model, _ = case_model(held)
    assert turned_fruit(model, model.grasps[0]) is None


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
