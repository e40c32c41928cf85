"""A stranger's ONNX file: which other files it may name, and how much memory it may take."""

import os
import resource

import numpy as np
import pytest
from tiny_onnx import write_external_model, write_large_model

from pipeline.batch.cache import stage_key
from recon.learned.fruit_model import fruit_model
from recon.learned.onnx_file import model_files
from recon.recon_failure import ReconFailure
from recon.silhouettes.mask import Window

PICTURE = np.zeros((192, 192, 3), np.uint8)


@pytest.fixture
def folder(tmp_path):
    """A batch's folder, with what lies beside it."""
    (tmp_path / "secret.bin").write_bytes(bytes(16))
    inside = tmp_path / "batch"
    (inside / "weights").mkdir(parents=True)
    (inside / "weights" / "far.bin").write_bytes(np.full(4, 2.5, np.float32).tobytes())
    (inside / "link.bin").symlink_to("../secret.bin")
    (inside / "linked").symlink_to("..")
    os.mkfifo(inside / "pipe.bin")
    return inside


@pytest.mark.parametrize(
    ("location", "why"),
    [
        ("../secret.bin", "is not in the folder of the model"),
        ("weights/../../secret.bin", "is not in the folder of the model"),
        ("/etc/passwd", "is not in the folder of the model"),
        ("", "is not in the folder of the model"),
        ("link.bin", "is a link"),
        ("linked/secret.bin", "is a link"),
        ("pipe.bin", "is a named pipe, not a file"),
        ("weights", "is a folder, not a file"),
        ("gone.bin", "does not exist"),
    ],
)
def test_numbers_are_read_from_plain_files_in_the_models_folder_alone(folder, location, why):
    path = folder / "model.onnx"
    write_external_model(path, location)
    with pytest.raises(
        ReconFailure, match=rf'model\.onnx keeps numbers in "{location}", which {why}; expected'
    ):
        fruit_model(path)
    assert model_files(path) == (path,)


def test_numbers_beside_the_model_are_read_and_are_part_of_the_key(folder):
    path, far = folder / "model.onnx", folder / "weights" / "far.bin"
    write_external_model(path, "weights/far.bin")
    assert model_files(path) == (path, far)

    def key():
        return stage_key("mesh", files=model_files(path), settings=None, rooms=("recon",))

    assert (
        fruit_model(path).session.run(None, {"images": np.zeros((1, 3, 192, 192), np.float32)})[0].max()
        == 2.5
    )
    before = key()
    far.write_bytes(np.full(4, 3.5, np.float32).tobytes())
    assert key() != before


@pytest.mark.parametrize("side", [40_000, 300_000])
def test_a_small_model_that_asks_for_much_memory_is_refused(tmp_path, side):
    """6.4 and 360 GB."""
    path = tmp_path / "large.onnx"
    write_large_model(path, side)
    assert path.stat().st_size < 1000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(
        ReconFailure, match=r"large\.onnx (is damaged, .*takes more than|failed while it ran)"
    ):
        fruit_model(path).log_odds([PICTURE], [Window(PICTURE, (0, 0), 1)])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2_500_000
