"""From arrays, drupe hands the finder the fruit of the files, and gives its answer as a small record."""

from dataclasses import replace

import numpy as np
import pytest
from explain_runs import DATA
from fake_explanation import fake_explanation

from drupe import DrupeError, explain, explain_fruit, read_recording
from recon.surface.mesh_file import read_mesh


@pytest.fixture(scope="module")
def recordings():
    """One recording, and another that is a little stronger."""
    first = read_recording(DATA / "grasp.h5")
    pads = tuple(replace(pad, force_N=1.002 * pad.force_N) for pad in first.pads)
    return [first, replace(first, pads=pads)]


def test_the_finder_gets_the_arrays_and_its_answer_comes_back(finder, recordings):
    mesh, pit = read_mesh(DATA / "fruit.ply"), read_mesh(DATA / "pit.ply")
    mismatch = explain(mesh, recordings, pit=pit, nu=0.42, category="nectarine")
    answer = fake_explanation()
    assert finder["case"].poisson_ratio == 0.42
    assert [grasp.name for grasp in finder["case"].grasps] == ["recording-1", "recording-2"]
    assert (mismatch.E_MPa, mismatch.E_without_MPa) == (answer.after.value, answer.before.value)
    assert mismatch.candidates["effect"].tolist() == [candidate.effect for candidate in answer.ranking]
    assert np.isfinite(mismatch.candidates["probability"]).all()
    assert mismatch.answer["format"] == "drupe-mismatch"
    assert mismatch.sentence


def test_a_fruit_of_a_batch_is_explained_with_the_batchs_settings(finder, batch):
    mismatch = explain_fruit(batch, "N01")
    assert finder["case"].poisson_ratio == 0.45
    assert mismatch.answer["case"] == "N01"
    with pytest.raises(DrupeError, match='has no fruit "N1"; did you mean "N01"'):
        explain_fruit(batch, "N1")
