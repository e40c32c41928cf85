"""The mat: print and mapping agree, tags are found to a fraction of a pixel, bad files are named."""

import cv2
import numpy as np
import pytest
from mat_scene import photographed, ring
from refusals import refused

from recon.cameras.printed_mat import detect_tags, mat_mapping, parse_mat, standard_mat, tag_bits
from recon.recon_failure import ReconProblem


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


def _moved(change):
    """The standard mat's tags after `change` of their corners, (4, 3) each, by number."""
    tags = mat_mapping(standard_mat())["tags"]
    return {"tags": {tag: change(int(tag), np.array(corners)) for tag, corners in tags.items()}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"dict": "APRILTAG_99"},
            'mat.json: dict: found "APRILTAG_99"; expected the name of a marker dictionary',
        ),
        ({"dict": None}, "dict: found null; expected the name"),
        ({"tags": {}}, "mat.json: tags: found {}; expected an object of at least four tags"),
        (
            {"tags": {"0": [[0, 0, 0]], "1": [], "2": [], "3": []}},
            r"tags\.0: found \[\[0, 0, 0\]\]; expected four corners",
        ),
        ({"tags": {"\u0663": 1, "1": 1, "2": 1, "3": 1}}, "tags: found the key"),  # an Arabic three
        (
            {"tags": {"a": 1, "1": 1, "2": 1, "3": 1}},
            r'tags: found the key "a"; expected numbers of tags, below 587',
        ),
        ({"W": -3}, "W: found -3; expected the mat's size in mm"),
        (
            _moved(lambda tag, c: c[::-1]),
            r"tags\.0: found corners that run counter-clockwise; expected top-left first",
        ),
        (_moved(lambda tag, c: c * [1, -1, 1]), r"does y point down\?"),
        (
            _moved(lambda tag, c: c[::-1] if tag == 7 else c),
            r"tags\.7: found corners that run counter-clockwise",
        ),
        (
            _moved(lambda tag, c: c - c.mean(axis=0)),
            r"tags\.1: found a tag that lies over tag 0; expected each in a",
        ),
        (_moved(lambda tag, c: c + np.multiply(tag == 12, [0, 12, 0])), r"tags\.12: found .* over tag 5"),
        (_moved(lambda tag, c: c[[0, 2, 1, 3]]), "the corners of a square, one after the other"),
        (_moved(lambda tag, c: c * 0.1), r"found a tag 1\.8 mm wide; expected 3 to 300 mm: is it in cm\?"),
    ],
)
def test_a_bad_mat_names_file_field_and_expectation(change, words):
    with refused(ReconProblem.BAD_MAT, words):
        parse_mat(mat_mapping(standard_mat()) | change, source="mat.json")
