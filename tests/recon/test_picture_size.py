"""A picture's size is known before it is decoded, and what is too large or too thin is never decoded."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from recon.failure import ReconFailure
from recon.photos import read_photo
from recon.picture_size import picture_px


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
        (b"BM" + bytes(5000), "is no picture that can be decoded"),
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
