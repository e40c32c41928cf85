"""Photos: whole ones are read, shrunk and their EXIF focal length kept; broken ones are named."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from refusals import refused

from recon.cameras.photos import photo_paths, read_photo, read_photos
from recon.recon_failure import ReconProblem

HEIC = Path(__file__).parents[1] / "data" / "quadrants.heic"


@pytest.fixture
def folder(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.jpg"), image)
    return tmp_path


def test_only_visible_files_are_photos(folder):
    (folder / "._1.jpg").write_bytes(b"x")
    (folder / "more.jpg").mkdir()
    (folder / "gone.png").symlink_to(folder / "nowhere.png")
    (folder / "A.JPEG").write_bytes(b"x")
    (folder / "z.png").symlink_to(folder / "0.jpg")
    assert [p.name for p in photo_paths(folder)] == ["0.jpg", "1.jpg", "2.jpg", "A.JPEG", "z.png"]
    assert photo_paths(folder / "none") == ()


@pytest.mark.parametrize(
    ("name", "spoil", "words"),
    [
        ("1.jpg", lambda data: data[: len(data) // 2], "cut short"),
        ("1.jpg", lambda data: with_small_picture(data)[: len(data) // 2], "cut short"),
        ("1.jpg", lambda data: b"", "is empty"),
        ("1.jpg", lambda data: b"not a picture", "no picture"),
        ("1.heic", lambda data: HEIC.read_bytes()[:600], "no picture that can be decoded"),
    ],
    ids=["cut", "cut, with a small picture in its headers", "empty", "text", "HEIC cut"],
)
def test_a_corrupt_photo_is_named(folder, name, spoil, words):
    path = folder / name
    path.write_bytes(spoil((folder / "0.jpg").read_bytes()))
    with refused(ReconProblem.UNREADABLE_PHOTO, rf"{name} .*{words}"):
        read_photos(folder)


def with_small_picture(jpeg: bytes) -> bytes:
    """A JPEG whose headers hold a picture with an end marker of its own."""
    small = b"\xff\xd8 small \xff\xd9"
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(small)) + small + jpeg[2:]


def test_big_photos_shrink_with_their_focal_length(tmp_path):
    path = tmp_path / "big.jpg"
    cv2.imwrite(str(path), np.zeros((300, 400, 3), np.uint8))
    path.write_bytes(_with_exif(path.read_bytes(), focal_35mm=27))
    photo = read_photo(path, longest_side_px=200)
    assert photo.image.shape == (150, 200, 3)
    assert photo.focal_px == pytest.approx(27 / 36 * 200)


def test_exif_is_never_needed(folder):
    assert read_photo(folder / "0.jpg").focal_px is None
    jpeg = (folder / "0.jpg").read_bytes()
    broken = b"Exif\x00\x00II*\x00\xff\xff\xff\x00"
    block = b"\xff\xe1" + struct.pack(">H", 2 + len(broken)) + broken
    (folder / "1.jpg").write_bytes(jpeg[:2] + block + jpeg[2:])
    assert read_photo(folder / "1.jpg").focal_px is None


def _with_exif(jpeg: bytes, *, focal_35mm: int) -> bytes:
    head = b"II*\x00" + struct.pack("<I", 8)
    first = struct.pack("<H", 1) + struct.pack("<HHII", 0x8769, 4, 1, 26) + struct.pack("<I", 0)
    second = struct.pack("<H", 1) + struct.pack("<HHIHH", 0xA405, 3, 1, focal_35mm, 0) + struct.pack("<I", 0)
    body = b"Exif\x00\x00" + head + first + second
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


def test_a_phones_heic_is_read_with_its_colours_and_focal_length(tmp_path):
    (tmp_path / "a.HEIC").write_bytes(HEIC.read_bytes())
    photo = read_photo(tmp_path / "a.HEIC")
    assert photo.image.shape == (72, 96, 3)
    blocks = {
        (18, 24): (200, 40, 40),
        (18, 72): (40, 180, 60),
        (54, 24): (50, 60, 190),
        (54, 72): (230, 220, 200),
    }
    for (row, column), rgb in blocks.items():
        assert np.abs(photo.image[row, column, ::-1].astype(int) - rgb).max() < 12
    assert photo.focal_px == pytest.approx(26 / 36 * 96)
