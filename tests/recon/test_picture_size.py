"""A picture's size is known before it is decoded, and what is too large or too thin is never decoded."""

import os
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest

from recon.cameras import photos
from recon.cameras.photos import read_photo
from recon.recon_failure import ReconFailure


def test_a_progressive_jpeg_has_the_limit_of_what_is_decoded_whole(tmp_path, monkeypatch):
    """A decoder holds all of its coefficients, whatever size is wanted."""
    monkeypatch.setattr(photos, "MOST_WHOLE_PIXELS", 4000)
    image = np.random.default_rng(1).integers(0, 255, (64, 80, 3), np.uint8)
    for progressive in (0, 1):
        cv2.imwrite(str(tmp_path / f"{progressive}.jpg"), image, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])
    assert read_photo(tmp_path / "0.jpg").image.shape == image.shape
    with pytest.raises(ReconFailure) as caught:
        read_photo(tmp_path / "1.jpg")
    assert (
        "has 80 x 64 pixels in a progressive JPEG; expected at most 0.004 million pixels: save it as a "
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
        (png(900, 900)[:-12], "is damaged or was cut short"),
        (
            cv2.imencode(".bmp", np.zeros((64, 64, 3), np.uint8))[1].tobytes(),
            "is a picture of another format (bitmap (BMP))",
        ),
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
