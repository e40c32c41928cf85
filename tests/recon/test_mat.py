"""The mat: print and mapping agree, tags are found to a fraction of a pixel, bad files are named."""

import cv2
import numpy as np
import pytest
from mat_scene import photographed, ring

from recon.failure import ReconFailure, ReconProblem
from recon.mat import detect_tags, mat_mapping, parse_mat, standard_mat, tag_bits


def test_mapping_round_trip():
    mat = standard_mat()
    again = parse_mat(mat_mapping(mat), source="mat.json")
    assert again.dictionary == mat.dictionary
    assert (again.width_mm, again.height_mm) == (mat.width_mm, mat.height_mm)
    assert all(np.allclose(again.corners_mm[t], c) for t, c in mat.corners_mm.items())


def test_standard_mat_is_forty_tags_around_a_blank_centre():
    mat = standard_mat()
    corners = np.concatenate(list(mat.corners_mm.values()))
    assert len(mat.corners_mm) == 40
    assert (mat.width_mm, mat.height_mm, mat.tag_mm) == (190.0, 190.0, 18.0)
    assert np.abs(corners[:, :2]).max(axis=1).min() == 37.0


def test_printed_bits_are_what_the_detector_reads():
    bits = tag_bits("APRILTAG_36h11", 17)
    assert bits.shape == (8, 8)
    assert not bits[0].any()
    picture = np.pad(np.kron(bits, np.ones((12, 12))) * 255, 40, constant_values=255).astype(np.uint8)
    tags, corners = detect_tags(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), standard_mat())
    assert tags.tolist() == [17]
    assert np.allclose(corners[0], np.array([(40, 40), (136, 40), (136, 136), (40, 136)]) - 0.5, atol=0.6)


def test_corners_are_found_to_half_a_pixel_where_tags_are_ten_pixels_wide():
    mat, cameras = standard_mat(), ring(3)
    for camera, photo in zip(cameras, photographed(cameras, egg=None, mat=mat), strict=True):
        tags, corners = detect_tags(photo.image, mat)
        true = np.stack([camera.project(mat.corners_mm[t]) for t in tags.tolist()])
        assert len(tags) > 25
        assert np.sqrt(np.mean((corners - true) ** 2)) < 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"dict": "APRILTAG_99"},
            r'mat.json: "dict" is \'APRILTAG_99\'; expected the name of a marker dictionary',
        ),
        ({"tags": {}}, r'"tags" is {}; expected an object of at least four tags'),
        ({"tags": {"0": [[0, 0, 0]], "1": [], "2": [], "3": []}}, r'"tags"."0" is .* expected four corners'),
        ({"W": -3}, r'"W" is -3; expected the mat\'s size in mm'),
        ({"tags": {"a": 1, "1": 1, "2": 1, "3": 1}}, r"key 'a'"),
    ],
)
def test_a_bad_mat_names_file_field_and_expectation(change, words):
    with pytest.raises(ReconFailure, match=words) as caught:
        parse_mat(mat_mapping(standard_mat()) | change, source="mat.json")
    assert caught.value.problem is ReconProblem.BAD_MAT
