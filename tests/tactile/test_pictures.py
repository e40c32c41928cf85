"""A frame of a gel is a PNG or a JPEG of a size that its header tells, whatever its name says."""

import os

import cv2
import numpy as np
import pytest

from tactile.io import pictures
from tactile.io.pictures import picture_pixels, read_picture
from tactile.tactile_failure import TactileFailure

IMAGE = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)


@pytest.mark.parametrize("kind", [".png", ".jpg"])
def test_pngs_and_jpegs_are_read(tmp_path, kind):
    data = cv2.imencode(kind, IMAGE)[1].tobytes()
    assert picture_pixels(data) == 48 * 64
    (tmp_path / f"a{kind}").write_bytes(data)
    assert read_picture(tmp_path / f"a{kind}").shape == IMAGE.shape


@pytest.mark.parametrize("kind", [".bmp", ".tiff", ".webp"])
def test_another_kind_under_a_pngs_name_is_refused_before_it_is_decoded(tmp_path, monkeypatch, kind):
    data = cv2.imencode(kind, IMAGE)[1].tobytes() + b"IEND"
    (tmp_path / "frame_000000.png").write_bytes(data)
    monkeypatch.setattr(cv2, "imdecode", None)  # it must not come so far
    with pytest.raises(TactileFailure, match="found a damaged picture, or no PNG or JPEG"):
        read_picture(tmp_path / "frame_000000.png")


def test_a_picture_of_another_size_than_its_header_says_is_damaged(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "picture_pixels", lambda _: 640 * 480)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", IMAGE)[1].tobytes())
    with pytest.raises(TactileFailure, match="found a damaged picture"):
        read_picture(tmp_path / "a.png")


@pytest.mark.parametrize("options", [None, "hwaccel;none"])
def test_ffmpeg_s_limits_hold_while_a_video_is_opened_and_the_user_s_options_are_back_afterwards(
    tmp_path, monkeypatch, options
):
    monkeypatch.delenv(pictures.FFMPEG_VARIABLE, raising=False)
    if options is not None:
        monkeypatch.setenv(pictures.FFMPEG_VARIABLE, options)
    seen, opened = [], cv2.VideoCapture

    def capture(*arguments):
        seen.append(os.environ[pictures.FFMPEG_VARIABLE])
        return opened(*arguments)

    monkeypatch.setattr(cv2, "VideoCapture", capture)
    (tmp_path / "left.avi").write_bytes(b"RIFF\0\0\0\0AVI ")
    with pytest.raises(TactileFailure, match="cannot be opened"):
        pictures.pictures_in(tmp_path / "left.avi")
    assert seen == ["protocol_whitelist;file|format_whitelist;avi,mov"]
    assert os.environ.get(pictures.FFMPEG_VARIABLE) == options
