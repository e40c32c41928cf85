"""The mat: print and mapping agree, tags are found to a fraction of a pixel, bad files are named."""

import cv2
import numpy as np
import pytest
from mat_scene import Board, photographed, ring
from refusals import refused

from recon.cameras.mat_poses import FEWEST_TAGS, cameras_from_mat
from recon.cameras.printed_mat import Mat, detect_tags, mat_mapping, parse_mat, standard_mat, tag_bits
from recon.recon_failure import ReconProblem

OFFICIAL_TAG_0 = """
########
#..#.#.#
##...#.#
##..####
#.#.####
##.#..##
####.###
########
"""
"""tag36h11/tag36_11_00000.png of github.com/AprilRobotics/apriltag-imgs (BSD-2-Clause), black as #."""


def kalibr_grid(*, tag_mm: float = 25.0, spacing: float = 0.3, count: int = 6) -> Mat:
    """A grid as Kalibr numbers it: tag 0 at the lower left, row by row upwards."""
    pitch, h = tag_mm * (1 + spacing), tag_mm / 2
    place = (np.arange(count) - (count - 1) / 2) * pitch
    square = np.array([(-h, h, 0), (h, h, 0), (h, -h, 0), (-h, -h, 0)])
    corners = {
        row * count + column: square + np.array([x, y, 0.0])
        for row, y in enumerate(place)
        for column, x in enumerate(place)
    }
    size = count * pitch + 20.0
    return Mat("APRILTAG_36h11", corners, size, size)


BOARDS = {
    "AprilTag's own images": Board(standard_mat(), turns=2),
    "a quarter turn": Board(standard_mat(), turns=3),
    "Kalibr": Board(kalibr_grid(), border=2, turns=2, square_mm=7.5),
    "two cells of border": Board(standard_mat(), border=2),
}


CAMERAS = ring(4, width=640, height=480, k1=-0.06)


def test_official_images_are_turned_by_half_a_turn_against_opencvs():
    official = np.array([[cell == "." for cell in row] for row in OFFICIAL_TAG_0.split()])
    assert (np.rot90(tag_bits("APRILTAG_36h11", 0), BOARDS["AprilTag's own images"].turns) == official).all()


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_tags_of_other_prints_are_read_with_the_mats_corners(board: Board):
    photos = photographed(CAMERAS, egg=None, mat=board.mat, page=board.page())
    for camera, photo in zip(CAMERAS, photos, strict=True):
        tags, corners = detect_tags(photo.image, board.mat)
        true = np.stack([camera.project(board.mat.corners_mm[t]) for t in tags.tolist()])
        assert len(tags) >= FEWEST_TAGS
        off = np.linalg.norm(corners - true, axis=2)
        assert np.median(off) < 0.6
        assert (off < 1.5).mean() > 0.9
    poses = cameras_from_mat(photos, board.mat)
    assert len(poses.cameras) == len(CAMERAS)
    assert poses.cameras[0].focal_px == pytest.approx(CAMERAS[0].focal_px, rel=0.01)
    for camera, true in zip(poses.cameras, CAMERAS, strict=True):
        assert np.linalg.norm(camera.place - true.place) < 2.0


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
