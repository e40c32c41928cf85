import csv
import json
from pathlib import Path

import numpy as np
import pytest

from recon.cameras.printed_mat import parse_mat
from recon.surface.mesh_file import read_mesh
from recon.triangle_mesh import volume_mm3
from samples.hexahedra import COARSE
from samples.sample_batch import write_batch
from samples.sample_failure import SampleFailure
from tactile.readers.recording import GelPad, read_recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "batch"
    lines: list[str] = []
    write_batch(folder, seed=3, fruits=1, photos=False, grasps=1, fineness=COARSE, progress=lines.append)
    assert any("frame 42 of 42" in line for line in lines)
    return folder


def test_batch_holds_what_a_user_would_hand_in(batch: Path) -> None:
    files = {str(p.relative_to(batch)) for p in batch.rglob("*") if p.is_file()}
    assert files == {
        "batch.toml",
        "fruits.csv",
        "mat.json",
        "answers.json",
        "fruits/N01/fruit.ply",
        "fruits/N01/grasps/grasp-1.h5",
    }
    parse_mat(json.loads((batch / "mat.json").read_text()), source="mat.json")


def test_answers_are_true_of_the_mesh_and_the_table(batch: Path) -> None:
    answer = json.loads((batch / "answers.json").read_text())["fruits"]["N01"]
    volume = volume_mm3(*read_mesh(batch / "fruits/N01/fruit.ply"))
    assert volume == pytest.approx(answer["volume_mm3"], rel=0.01)
    with (batch / "fruits.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert float(row["height_mm"]) == pytest.approx(answer["size_mm"][2], abs=0.5)
    assert 0.15 < answer["E_MPa"] < 1.6


def test_recording_keeps_the_format(batch: Path) -> None:
    recording = read_recording(batch / "fruits/N01/grasps/grasp-1.h5")
    assert recording.support == "free"
    assert recording.fruit_id == "N01"
    for pad in recording.pads:
        assert isinstance(pad, GelPad)
        assert pad.displacement_mm.shape == (len(recording.time_s), 400, 3)
        assert 0.003 < pad.displacement_mm[:10].std() < 0.006
        assert pad.force_N[int(np.argmin(recording.aperture_mm)), :, 2].sum() > 1.0
    gap = [
        np.linalg.norm(a[:3, 3] - b[:3, 3])
        for a, b in zip(recording.pads[0].pose, recording.pads[1].pose, strict=True)
    ]
    assert recording.aperture_mm == pytest.approx(gap, abs=1e-9)


def test_a_folder_in_use_is_left_alone(batch: Path) -> None:
    with pytest.raises(SampleFailure, match="not an empty folder"):
        write_batch(batch, seed=3, fruits=1, photos=False)
