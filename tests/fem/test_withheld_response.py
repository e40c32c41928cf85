"""What a mesh withholds of a recording's response: two meshes agree once it is put back."""

from dataclasses import replace

import numpy as np
import pytest
from injected_mismatch import finders_mesh, injected_case, only_grasp, true_mesh

from fem.estimation.compliance_fit import rigid_motion
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.evidence.withheld_response import (
    WITHHELD,
    WITHHELD_SD,
    leave_withheld,
    withheld_response,
)
from fem.mismatch.model.baseline import baseline
from fem.mismatch.model.forward_model import ForwardModel

COMPLIANCE = 4.0
QUIET = 0.3


def forward_on(mesh, *, noise: float = QUIET) -> ForwardModel:
    """Of the first grasp, by a sensor with this share of the injected noise."""
    case = injected_case(noise=noise, mesh=mesh)
    (grasp,) = only_grasp(case, 0).grasps
    pads = tuple(
        replace(pad, displacement_sd_mm=noise * pad.displacement_sd_mm) for pad in grasp.history.pads
    )
    quiet = replace(grasp, history=replace(grasp.history, pads=pads))
    return ForwardModel(base=baseline(replace(case, grasps=(quiet,))), compliance=COMPLIANCE)


@pytest.fixture(scope="module")
def coarse():
    return forward_on(finders_mesh)


def without_motion(recording, field):
    """A field where markers touch, each frame's rigid motion taken out."""
    rigid, left = rigid_motion(recording.tracks.place_mm), []
    for frame_field, touching in zip(field, recording.tracks.episode >= 0, strict=True):
        if touching.sum() < 8:
            continue
        modes, here = rigid[touching].reshape(-1, 6), frame_field[touching].ravel()
        left.append(here - modes @ np.linalg.lstsq(modes, here, rcond=None)[0])
    return np.concatenate(left)


def test_two_meshes_agree_better_with_what_each_withholds(coarse):
    finer = forward_on(true_mesh)
    (recording,), (other,) = coarse.base.grasps, finer.base.grasps
    plain = without_motion(recording, recording.tracks.unit_displacement - other.tracks.unit_displacement)
    added = without_motion(recording, withheld_response(coarse, recording) - withheld_response(finer, other))
    assert np.linalg.norm(plain + added) < 0.5 * np.linalg.norm(plain)


def test_it_is_a_known_part_of_the_plain_model_of_which_little_is_in_doubt(coarse):
    (column,) = (nuisance for nuisance in common_nuisances(coarse) if nuisance.name == WITHHELD)
    assert (column.mean, column.sd) == (1.0, WITHHELD_SD)
    (recording,) = coarse.base.grasps
    expected = COMPLIANCE * withheld_response(coarse, recording)
    np.testing.assert_array_equal(column.fields[0].markers, expected)


def test_where_it_is_left_out_there_is_no_column():
    forward = forward_on(finders_mesh)
    leave_withheld(forward, forward.base.grasps[0])
    assert withheld_response(forward, forward.base.grasps[0]) is None
    assert WITHHELD not in [nuisance.name for nuisance in common_nuisances(forward)]
