"""Plans, protocols and files of mismatch cases."""

from pathlib import Path

import numpy as np
import pytest
from mismatch_ball import drawn_ball, still_recording

from recon.surface.mesh_file import read_mesh
from samples.mismatch.case_files import write_case_files
from samples.mismatch.case_simulation import planned
from samples.mismatch.four_grasps import four_manners, motion_of
from samples.mismatch.injected import drawn_parameters
from samples.sample_failure import SampleFailure
from tactile.io.recording import GelPad, read_recording


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
