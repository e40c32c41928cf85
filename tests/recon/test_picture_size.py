"""A picture's size is known before it is decoded, and what is too large or too thin is never decoded."""

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

import pipeline
import recon
import tactile
from recon.cameras import photos
from recon.cameras.photos import read_photo
from recon.cameras.picture_size import first_scan, in_one_pass, picture_px
from recon.recon_failure import ReconFailure


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("size", [(64, 80), (123, 457), (1000, 300)])
def test_the_header_says_what_the_decoder_finds(suffix, size):
    image = np.random.default_rng(1).integers(0, 255, (*size, 3), np.uint8)
    data = cv2.imencode(suffix, image)[1].tobytes()
    assert picture_px(data) == (size[1], size[0])
    progressive = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert picture_px(progressive) == (size[1], size[0])


def test_every_cut_of_a_header_is_no_size_and_no_crash():
    data = cv2.imencode(".jpg", np.zeros((80, 80, 3), np.uint8))[1].tobytes()
    assert all(picture_px(data[:end]) in (None, (80, 80)) for end in range(700))


def frame(kind, width, height, *, in_first_scan):
    """Headers of a JPEG of three colours, without a picture."""
    held = struct.pack(">BHHB", 8, height, width, 3) + bytes((1, 17, 0, 2, 17, 0, 3, 17, 0))
    scan = bytes((in_first_scan,)) + bytes((1, 0)) * in_first_scan + bytes((0, 63, 0))
    parts = ((kind, held), (0xDA, scan))
    return b"\xff\xd8" + b"".join(
        struct.pack(">BBH", 0xFF, marker, 2 + len(body)) + body for marker, body in parts
    )


def test_what_a_decoder_must_hold_whole_is_told_from_the_header():
    image = np.random.default_rng(1).integers(0, 255, (64, 80, 3), np.uint8)
    for progressive in (0, 1):
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
        assert in_one_pass(data) is not bool(progressive)
        assert data[first_scan(data) : first_scan(data) + 2] == b"\xff\xda"
    assert in_one_pass(frame(0xC0, 80, 64, in_first_scan=3))
    assert not in_one_pass(frame(0xC0, 80, 64, in_first_scan=1))  # a scan for each colour
    assert not in_one_pass(frame(0xC2, 80, 64, in_first_scan=3))


@pytest.mark.parametrize(("kind", "in_first_scan"), [(0xC2, 3), (0xC0, 1)])
def test_a_progressive_jpeg_has_the_limit_of_what_is_decoded_whole(
    tmp_path, monkeypatch, kind, in_first_scan
):
    path = tmp_path / "a.jpg"
    path.write_bytes(frame(kind, 16000, 12000, in_first_scan=in_first_scan) + b"\xff\xd9")
    monkeypatch.setattr(cv2, "imdecode", None)  # it must not come so far
    with pytest.raises(ReconFailure) as caught:
        read_photo(path)
    assert (
        "has 16000 x 12000 pixels in a progressive JPEG; expected at most 60 million pixels: save it as a "
        "baseline JPEG, make it smaller or remove it." in caught.value.detail
    )


def png(width, height):
    def chunk(kind, held):
        return struct.pack(">I", len(held)) + kind + held + struct.pack(">I", zlib.crc32(kind + held))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    held = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(99))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + held


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (png(32000, 32000), "has 32000 x 32000 pixels; expected at most 60 million pixels"),
        (png(1, 60000), "has 1 x 60000 pixels, too few"),
        (png(6000, 100), "has 6000 x 100 pixels, a strip"),
        (png(900, 900)[:-12], "is a PNG that was cut short"),
        (b"BM" + bytes(5000), "is a picture of another format (bitmap (BMP))"),
        (b"no picture" + bytes(5000), "is no picture that can be decoded"),
    ],
)
def test_what_cannot_be_a_photo_is_refused_before_it_is_decoded(tmp_path, data, said):
    path = tmp_path / "a.png"
    path.write_bytes(data)
    with pytest.raises(ReconFailure) as caught:
        read_photo(path)
    assert said in caught.value.detail


def test_a_phones_200_megapixels_are_decoded_at_a_share_of_their_sides(tmp_path):
    # 61.44 megapixels, whose decoding at full size this test does not pay.
    image = np.full((7680, 8000, 3), 90, np.uint8)
    cv2.imwrite(str(tmp_path / "a.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 30])
    photo = read_photo(tmp_path / "a.jpg")
    assert photo.image.shape == (1536, 1600, 3)
    assert abs(float(photo.image.mean()) - 90) < 2


def test_names_reach_nobody_with_control_characters(tmp_path):
    path = tmp_path / "a\x1b[31m.jpg"
    path.write_bytes(b"")
    with pytest.raises(ReconFailure) as caught:
        read_photo(path)
    assert "a[31m.jpg" in caught.value.detail


def test_a_picture_of_another_size_than_its_header_says_is_damaged(tmp_path, monkeypatch):
    """Whatever a reader of headers is made to believe, the decoded picture is held to it."""
    monkeypatch.setattr(photos, "picture_px", lambda _: (640, 480))
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", np.zeros((64, 80, 3), np.uint8))[1].tobytes())
    with pytest.raises(ReconFailure, match="its header says 640 x 480 pixels, it holds 80 x 64"):
        read_photo(tmp_path / "a.png")


DECODES = """
import {room}
import cv2, numpy
data = bytearray(cv2.imencode(".jpg", numpy.zeros((64, 64, 3), numpy.uint8))[1].tobytes())
place = data.index(b"\\xff\\xc0")
for side in (7700, 7800):
    data[place + 5 : place + 9] = side.to_bytes(2, "big") * 2
    try:
        image = cv2.imdecode(numpy.frombuffer(data, numpy.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        image = None
    print(side, image is not None)
"""
"""59.3 and 60.8 million pixels."""


@pytest.mark.parametrize("room", ["pipeline", "recon", "tactile"])
def test_the_decoder_itself_refuses_more_pixels_than_a_whole_photo_has(room):
    environment = {name: held for name, held in os.environ.items() if not name.startswith("OPENCV")}
    command = [sys.executable, "-c", DECODES.format(room=room)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["7700", "True", "7800", "False"]
    assert photos.MOST_WHOLE_PIXELS == 60_000_000


@pytest.mark.parametrize(
    ("stated", "held"),
    [("999999999999", "60000000"), ("1000000", "1000000"), ("60MB", "60000000"), ("9" * 5000, "60000000")],
)
def test_a_larger_limit_of_the_user_does_not_lift_it(stated, held):
    shows = "import os, tactile; print(os.environ['OPENCV_IO_MAX_IMAGE_PIXELS'])"
    environment = {**os.environ, "OPENCV_IO_MAX_IMAGE_PIXELS": stated}
    ran = subprocess.run(
        [sys.executable, "-c", shows], env=environment, capture_output=True, text=True, check=True
    )
    assert ran.stdout.strip() == held


def test_the_rooms_set_the_limit_by_the_same_lines():
    lines = {Path(room.__file__).read_text().split("\n", 1)[1] for room in (pipeline, recon, tactile)}
    assert len(lines) == 1
