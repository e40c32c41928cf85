"""Plans, protocols and files of mismatch cases."""

import json
from pathlib import Path

import numpy as np
import pytest
from mismatch_ball import drawn_ball, still_recording

from recon.surface.mesh_file import read_mesh
from samples.gel_contact import Gel
from samples.grasp_plan import four_manners, motion_of
from samples.mismatch.bank import store_truths, stored_truths, write_case_files
from samples.mismatch.case_simulation import planned
from samples.mismatch.injected import drawn_parameters
from samples.mismatch.true_recording import PadTruth, TrueRecording
from samples.sample_failure import SampleFailure
from tactile.readers.recording import GelPad, read_recording


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


def test_the_four_grasps_have_the_frames_of_the_shared_cases() -> None:
    motions = [motion_of(m) for m in four_manners(1.95)]
    assert [int(m.recorded.sum()) for m in motions] == [82, 67, 73, 67]
    for m in motions:
        assert np.all(np.diff(m.time_s) > 0)
        shown = m.travel_mm[m.recorded]
        assert np.all(shown[:30] < 0)
        assert np.all(shown[-15:] < 0)
    assert motions[0].travel_mm.max() == 1.95
    assert [m.shear_mm.max() for m in motions] == [0.0, 0.0, 1.2, 0.0]


def test_an_injected_offset_takes_the_place_of_the_spread() -> None:
    plan = planned("x", (("pit_offset", 3.4),), seed=(1, 2))
    offset = np.subtract(plan.drawn.fruit.pit.centre_mm, plan.drawn.prior.centre_mm)
    assert offset == pytest.approx(plan.injected[0].parameters["offset_mm"])
    assert np.linalg.norm(offset) == pytest.approx(3.4)


def test_an_effect_that_is_not_in_the_catalogue_is_refused() -> None:
    with pytest.raises(SampleFailure, match="no effect 'rust'"):
        drawn_parameters("rust", 1.0, np.random.default_rng(0))


def test_a_case_is_read_back_and_its_air_carries_the_noise(tmp_path: Path) -> None:
    drawn = drawn_ball()
    write_case_files(
        tmp_path / "case-1", drawn, (still_recording(60),), peaks_N=(20.0,), rng=np.random.default_rng(1)
    )
    assert [p.name for p in sorted((tmp_path / "case-1").iterdir())] == [
        "case.toml", "fruit.ply", "grasp-1.h5", "pit.ply",
    ]  # fmt: skip
    vertices, _ = read_mesh(tmp_path / "case-1" / "fruit.ply")
    error = np.linalg.norm(vertices, axis=1) - 25.0
    assert np.sqrt(np.mean(error**2)) == pytest.approx(0.1, rel=0.02)
    read = read_recording(tmp_path / "case-1" / "grasp-1.h5")
    pad = read.pads[0]
    assert isinstance(pad, GelPad)
    noise_N = pad.force_N - pad.force_N.mean(axis=0)
    assert noise_N.std() == pytest.approx(2e-4 * 20.0, rel=0.05)
    assert pad.force_N.mean(axis=0).std() == pytest.approx(2e-4 * 10.0, rel=0.2)
    assert not list(tmp_path.glob(".*partial"))
