"""Photos: whole ones are read, broken and useless ones are named by reason."""

import os
import re
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from PIL import ExifTags, Image
from refusals import refused

from recon.cameras import photos
from recon.cameras.photos import photo_paths, read_photo, read_photos
from recon.cameras.printed_mat import detect_tags, standard_mat
from recon.checks.photo_check import checked_photos, tag_optics
from recon.recon_failure import ReconFailure, ReconProblem


def test_a_progressive_jpeg_has_the_limit_of_what_is_decoded_whole(tmp_path, monkeypatch):
    """A decoder holds all of its coefficients, whatever size is wanted."""
    monkeypatch.setattr(photos, "MOST_WHOLE_PIXELS", 4000)
    image = np.random.default_rng(1).integers(0, 255, (64, 80, 3), np.uint8)
    for progressive in (0, 1):
        cv2.imwrite(str(tmp_path / f"{progressive}.jpg"), image, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])
    assert read_photo(tmp_path / "0.jpg").image.shape == image.shape
    words = (
        "has 80 x 64 pixels in a progressive JPEG; expected at most 0.004 million pixels: save it as a "
        "baseline JPEG, make it smaller or remove it."
    )
    with refused(ReconProblem.UNREADABLE_PHOTO, words):
        read_photo(tmp_path / "1.jpg")


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
    with refused(ReconProblem.UNREADABLE_PHOTO, re.escape(said)):
        read_photo(path)


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


HEIC = Path(__file__).parents[1] / "data" / "heic" / "quadrants.heic"


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
        ("1.jpg", lambda data: with_header(data, b"\xff\xd8 small \xff\xd9")[: len(data) // 2], "cut short"),
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


def with_header(jpeg: bytes, held: bytes) -> bytes:
    """A JPEG with these bytes in a header of its own: Exif, or a picture with an end marker."""
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(held)) + held + jpeg[2:]


def test_big_photos_shrink_with_their_focal_length(tmp_path):
    path, exif = tmp_path / "big.jpg", Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 27
    Image.new("RGB", (400, 300)).save(path, exif=exif)
    photo = read_photo(path, longest_side_px=200)
    assert photo.image.shape == (150, 200, 3)
    assert photo.focal_px == pytest.approx(27 / 36 * 200)


def test_exif_is_never_needed(folder):
    assert read_photo(folder / "0.jpg").focal_px is None
    jpeg = (folder / "0.jpg").read_bytes()
    (folder / "1.jpg").write_bytes(with_header(jpeg, b"Exif\x00\x00II*\x00\xff\xff\xff\x00"))
    assert read_photo(folder / "1.jpg").focal_px is None


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


MAT = standard_mat()


@cache
def pictures(count=13):
    return tuple(photographed(ring(count), egg=Egg(), mat=MAT))


def spoilt(which, change):
    return [replace(p, image=change(p.image)) if i in which else p for i, p in enumerate(pictures())]


def blurred(sigma):
    return lambda image: cv2.GaussianBlur(image, (0, 0), sigma)


def mirrored(image):
    return np.ascontiguousarray(image[:, ::-1])


def brighter(gain):
    return lambda image: np.clip(image * gain, 0, 255).astype(np.uint8)


def test_good_photos_pass_unchanged_without_a_word():
    checked = checked_photos(pictures(), MAT)
    assert checked.warnings == ()
    assert all(a.image is b.image for a, b in zip(checked.photos, pictures(), strict=True))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (mirrored, r"Left out: 004\.png: mirrored"),
        (
            blurred(8),
            r"Left out: 004\.png: (too blurred for drupe to read its tags|"
            r"shows no tags of the mat .too blurred)",
        ),
        (lambda image: np.full_like(image, 120), r"Left out: 004\.png: .*; retake it"),
        (brighter(0.3), r"004\.png: too dark .*; left out"),
        (brighter(3.0), r"004\.png: overexposed .*; left out"),
    ],
)
def test_a_useless_photo_is_left_out_by_name_and_reason(change, words):
    checked = checked_photos(spoilt({4}, change), MAT)
    (warning,) = checked.warnings
    assert re.search(words, warning)
    assert "004.png" not in [p.name for p in checked.photos]
    assert len(checked.photos) == len(pictures()) - 1


def test_photos_of_unequal_brightness_are_brought_to_one():
    checked = checked_photos(spoilt({0, 2, 4, 6, 8, 10}, brighter(0.6)), MAT)
    assert checked.warnings == ()
    whites = []
    for photo in checked.photos:
        grey = cv2.cvtColor(photo.image, cv2.COLOR_BGR2GRAY)
        whites.append(tag_optics(grey, detect_tags(photo.image, MAT)[1]).white)
    assert np.ptp(whites) < 0.06 * np.median(whites)


def test_mirrored_sets_are_refused_with_and_without_a_mat():
    for mat in (MAT, None):
        with refused(ReconProblem.MAT_NOT_FOUND, "13 of 13 photos are mirrored"):
            checked_photos(spoilt(range(13), mirrored), mat)


def test_copies_count_once():
    again = [replace(p, name=f"copy of {p.name}") for p in pictures()[:2]]
    checked = checked_photos([*pictures(), *again], MAT)
    assert len(checked.photos) == len(pictures())
    assert "copy of 000.png = 000.png" in checked.warnings[0]


@pytest.mark.parametrize("mat", [MAT, None], ids=["mat", "no mat"])
def test_a_set_of_copies_is_refused_and_the_copies_are_named(mat):
    a, b = pictures()[:2]
    set_of_two = [a, b, replace(a, name="x.png"), replace(b, name="y.png")]
    with refused(
        ReconProblem.TOO_FEW_VIEWS,
        r"2 photos are copies of another \(x\.png = 000\.png, y\.png = 001\.png\).* "
        "The set without copies holds 2 photos; a shape needs at least 3",
    ):
        checked_photos(set_of_two, mat)


def test_a_covered_mat_is_told():
    def halved(image):
        image = image.copy()
        tags, corners = detect_tags(image, MAT)
        for tag, quad in zip(tags.tolist(), corners, strict=True):
            if MAT.corners_mm[tag][:, 0].mean() < 0:
                cv2.fillPoly(image, [np.rint(quad).astype(np.int32)], (225, 225, 225))
        return image

    checked = checked_photos(spoilt(range(13), halved), MAT)
    assert "of the mat's 40 tags are in no photo" in checked.warnings[0]


@pytest.mark.parametrize("sigma", [1.5, 2.5])
def test_smear_of_edges_is_that_of_the_blur(sigma):
    """The pictures' own smear (pixel box, 0.3 to 0.6 px) adds in squares."""
    image = cv2.resize(pictures()[0].image, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    corners = detect_tags(image, MAT)[1]
    sharp = tag_optics(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), corners).blur_px
    soft = tag_optics(cv2.cvtColor(blurred(sigma)(image), cv2.COLOR_BGR2GRAY), corners).blur_px
    assert np.sqrt(soft**2 - sharp**2) == pytest.approx(sigma, rel=0.25)


def test_another_mat_than_the_printed_one_is_not_found():
    other = replace(MAT, dictionary="5X5_100")
    with refused(ReconProblem.MAT_NOT_FOUND, r"No marker of the mat \(5X5_100, 40 tags\) .* 13 photos"):
        checked_photos(pictures(), other)


def test_without_a_mat_the_first_photo_stays_or_the_set_is_refused():
    """It says where the suture is."""
    dim = checked_photos(spoilt({0}, brighter(0.15)), None)
    assert dim.photos[0].name == "000.png"
    assert "000.png: too dark" in dim.warnings[0]
    assert "used anyway" in dim.warnings[0]
    with pytest.raises(ReconFailure, match=r"The first photo, 000\.png, is unusable \(mirrored"):
        checked_photos(spoilt({0}, mirrored), None)
