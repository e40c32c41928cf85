"""Photos at first sight: useless ones are left out by name and reason, good ones pass without a word."""

import re
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from refusals import refused

from recon.cameras.printed_mat import detect_tags, standard_mat
from recon.checks.photo_check import checked_photos, tag_optics
from recon.recon_failure import ReconFailure, ReconProblem

MAT = standard_mat()


@cache
def photos(count=13):
    return tuple(photographed(ring(count), egg=Egg(), mat=MAT))


def spoilt(which, change):
    return [replace(p, image=change(p.image)) if i in which else p for i, p in enumerate(photos())]


def blurred(sigma):
    return lambda image: cv2.GaussianBlur(image, (0, 0), sigma)


def mirrored(image):
    return np.ascontiguousarray(image[:, ::-1])


def brighter(gain):
    return lambda image: np.clip(image * gain, 0, 255).astype(np.uint8)


def test_good_photos_pass_unchanged_without_a_word():
    checked = checked_photos(photos(), MAT)
    assert checked.warnings == ()
    assert all(a.image is b.image for a, b in zip(checked.photos, photos(), strict=True))


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
    assert len(checked.photos) == len(photos()) - 1


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
    again = [replace(p, name=f"copy of {p.name}") for p in photos()[:2]]
    checked = checked_photos([*photos(), *again], MAT)
    assert len(checked.photos) == len(photos())
    assert "copy of 000.png = 000.png" in checked.warnings[0]


@pytest.mark.parametrize("mat", [MAT, None], ids=["mat", "no mat"])
def test_a_set_of_copies_is_refused_and_the_copies_are_named(mat):
    a, b = photos()[:2]
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
    image = cv2.resize(photos()[0].image, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    corners = detect_tags(image, MAT)[1]
    sharp = tag_optics(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), corners).blur_px
    soft = tag_optics(cv2.cvtColor(blurred(sigma)(image), cv2.COLOR_BGR2GRAY), corners).blur_px
    assert np.sqrt(soft**2 - sharp**2) == pytest.approx(sigma, rel=0.25)


def test_another_mat_than_the_printed_one_is_not_found():
    other = replace(MAT, dictionary="5X5_100")
    with refused(ReconProblem.MAT_NOT_FOUND, r"No marker of the mat \(5X5_100, 40 tags\) .* 13 photos"):
        checked_photos(photos(), other)


def test_without_a_mat_the_first_photo_stays_or_the_set_is_refused():
    """It says where the suture is."""
    dim = checked_photos(spoilt({0}, brighter(0.15)), None)
    assert dim.photos[0].name == "000.png"
    assert "000.png: too dark" in dim.warnings[0]
    assert "used anyway" in dim.warnings[0]
    with pytest.raises(ReconFailure, match=r"The first photo, 000\.png, is unusable \(mirrored"):
        checked_photos(spoilt({0}, mirrored), None)
