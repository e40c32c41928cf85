"""A frame of a gel is a PNG or a JPEG of bounded size, whatever its name says."""

import cv2
import numpy as np
import pytest

from tactile.readers import pictures
from tactile.readers.pictures import read_picture
from tactile.tactile_failure import TactileFailure

IMAGE = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)


@pytest.mark.parametrize("kind", [".png", ".jpg"])
def test_pngs_and_jpegs_are_read(tmp_path, kind):
    (tmp_path / f"a{kind}").write_bytes(cv2.imencode(kind, IMAGE)[1].tobytes())
    assert read_picture(tmp_path / f"a{kind}").shape == IMAGE.shape


@pytest.mark.parametrize("kind", [".bmp", ".tiff", ".webp"])
def test_another_kind_under_a_pngs_name_is_refused_before_it_is_decoded(tmp_path, monkeypatch, kind):
    data = cv2.imencode(kind, IMAGE)[1].tobytes() + b"IEND"
    (tmp_path / "frame_000000.png").write_bytes(data)
    monkeypatch.setattr(cv2, "imdecode", None)  # it must not come so far
    with pytest.raises(TactileFailure, match="found a damaged picture, no PNG or JPEG"):
        read_picture(tmp_path / "frame_000000.png")


def test_a_picture_larger_than_any_camera_s_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_PIXELS", 3000)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", IMAGE)[1].tobytes())
    with pytest.raises(TactileFailure, match="found frames of 64 x 48 pixels, expected at most"):
        read_picture(tmp_path / "a.png")


def test_a_picture_that_does_not_fit_into_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_FRAME_MEMORY", 20_000_000)
    large = np.zeros((6000, 6000, 3), np.uint8)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", large)[1].tobytes())
    with pytest.raises(TactileFailure, match="or more than 20 MB of pixels"):
        read_picture(tmp_path / "a.png")
