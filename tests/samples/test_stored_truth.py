"""A stored fruit comes back as it was."""

import json
from pathlib import Path

import numpy as np
import pytest

from samples.gel_contact import Gel
from samples.mismatch.case_files import store_truths, stored_truths
from samples.mismatch.true_recording import PadTruth, TrueRecording


def truth(seed: int) -> TrueRecording:
    rng = np.random.default_rng(seed)
    left, right = (
        PadTruth(
            pose=rng.normal(size=(5, 4, 4)), displacement_mm=rng.normal(size=(5, 9, 3)),
            force_N=rng.normal(size=(5, 9, 3)),
        )
        for _ in range(2)
    )  # fmt: skip
    return TrueRecording(
        name=f"grasp-{seed}", time_s=np.arange(5.0), aperture_mm=rng.normal(size=5),
        rest_mm=rng.normal(size=(9, 3)), gel=Gel(friction=1.6), pads=(left, right),
    )  # fmt: skip


def test_a_stored_fruit_comes_back_as_it_was(tmp_path: Path) -> None:
    truths = (truth(1), truth(2))
    store_truths(tmp_path / "fruit.npz", truths)
    for stored, recording in zip(stored_truths(tmp_path / "fruit.npz"), truths, strict=True):
        assert (stored.name, stored.gel) == (recording.name, recording.gel)
        np.testing.assert_array_equal(stored.rest_mm, recording.rest_mm)
        for pad, true_pad in zip(stored.pads, recording.pads, strict=True):
            np.testing.assert_array_equal(pad.pose, true_pad.pose)
            np.testing.assert_allclose(pad.displacement_mm, true_pad.displacement_mm, rtol=1e-6)
            np.testing.assert_allclose(pad.force_N, true_pad.force_N, rtol=1e-6)


def test_another_format_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "fruit.npz", words=np.array(json.dumps({"format": 0, "grasps": []})))
    with pytest.raises(ValueError, match="simulate the fruit anew"):
        stored_truths(tmp_path / "fruit.npz")
