"""The mat and poses from it: print and mapping agree, injected cameras come back, bad files are named."""

import pickle
import signal
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from mat_scene import Board, Egg, photographed, ring
from refusals import refused
from small_batches import python

from recon.cameras import motion
from recon.cameras.camera import Camera
from recon.cameras.ground_plane import upright
from recon.cameras.mat_poses import FEWEST_TAGS, cameras_from_mat
from recon.cameras.motion import cameras_from_features, cameras_from_motion
from recon.cameras.photos import Photo
from recon.cameras.plane_motion import placed
from recon.cameras.printed_mat import Mat, detect_tags, mat_mapping, parse_mat, standard_mat, tag_bits
from recon.cameras.view_plan import missing_views
from recon.learned.fruit_model import SHIPPED, FruitModel
from recon.recon_failure import ReconFailure, ReconProblem

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


@pytest.fixture(scope="module")
def bent():
    cameras = ring(7, width=640, height=480, k1=-0.06)
    return cameras, photographed(cameras, egg=Egg(), mat=standard_mat())


@pytest.fixture(scope="module")
def poses(bent):
    return cameras_from_mat(bent[1], standard_mat())


def test_cameras_come_back_without_exif_within_their_error_bars(bent, poses):
    cameras, _ = bent
    assert len(poses.cameras) == len(cameras)
    assert poses.cameras[0].focal_px == pytest.approx(cameras[0].focal_px, rel=3e-3)
    assert poses.cameras[0].k1 == pytest.approx(-0.06, abs=0.02)
    for camera, true in zip(poses.cameras, cameras, strict=True):
        assert np.linalg.norm(camera.place - true.place) < 1.0
    assert poses.reprojection_px < 0.5
    assert abs(poses.cameras[0].focal_px - cameras[0].focal_px) < 4 * poses.focal_sd_px
    assert 1e-3 < poses.scale_sd < 2e-3


def test_a_misread_tag_moves_no_camera_and_is_left_out():
    """Exact corners but for one tag that the photo shows 60 px away."""
    mat = standard_mat()
    cameras = ring(7, width=640, height=480, k1=-0.06)
    photos = []
    for camera in cameras:
        seen = {tag: camera.project(corners) for tag, corners in mat.corners_mm.items()}
        inside = {t: px for t, px in seen.items() if (px > 0).all() and (px < [640, 480]).all()}
        photos.append(
            Photo(
                camera.name,
                np.zeros((480, 640, 3), np.uint8),
                tags=(np.array([*inside]), np.array([*inside.values()])),
            )
        )
    photos[2].tags[1][0] += 60.0
    poses = cameras_from_mat(photos, mat)
    assert poses.cameras[0].focal_px == pytest.approx(cameras[0].focal_px, rel=1e-4)
    assert poses.cameras[0].k1 == pytest.approx(-0.06, abs=1e-3)
    for recovered_camera, true in zip(poses.cameras, cameras, strict=True):
        assert np.linalg.norm(recovered_camera.place - true.place) < 0.05
    assert poses.reprojection_px < 0.02


def test_two_photos_with_tags_are_too_few_and_without_tags_the_mat_is_not_found(bent):
    _, photos = bent
    grey = [Photo(f"g{i}.png", np.full((480, 640, 3), 90, np.uint8)) for i in range(4)]
    with refused(ReconProblem.TOO_FEW_VIEWS, r"Only 2 of 6 photos show at least 4 tags"):
        cameras_from_mat([*photos[:2], *grey], standard_mat())
    with refused(ReconProblem.MAT_NOT_FOUND, r"No marker of the mat .* in any of 4 photos"):
        cameras_from_mat(grey, standard_mat())


def test_photos_of_another_size_are_left_out_with_a_warning(bent):
    _, photos = bent
    first_cut = Photo(photos[0].name, np.ascontiguousarray(photos[0].image[8:-8]))
    poses = cameras_from_mat([first_cut, *photos[1:5]], standard_mat())
    assert poses.used.tolist() == [1, 2, 3, 4]
    assert poses.warnings[0].startswith(
        "1 of 5 photos of the mat do not have the usual size of 640 x 480 pixels"
    )


def test_a_mat_of_another_layout_is_refused(bent):
    _, photos = bent
    shuffled = standard_mat()
    other = dict(zip(shuffled.corners_mm, reversed(list(shuffled.corners_mm.values())), strict=True))
    wrong = type(shuffled)(shuffled.dictionary, other, shuffled.width_mm, shuffled.height_mm)
    mirrored = [Photo(p.name, np.ascontiguousarray(p.image[:, ::-1])) for p in photos]
    with pytest.raises(ReconFailure):
        cameras_from_mat(mirrored, wrong)


@pytest.fixture(scope="module")
def photos():
    return photographed(ring(9), egg=Egg(), mat=standard_mat())


@pytest.mark.slow
def test_x_points_to_where_the_first_photo_was_taken(photos):
    x, y, z = cameras_from_motion(photos, height_mm=48.0).cameras[0].place
    assert x > 0
    assert z > 0
    assert abs(np.degrees(np.arctan2(y, x))) < 3


@pytest.mark.proof
def test_a_first_photo_that_cannot_be_placed_is_refused(photos):
    noise = np.random.default_rng(2).integers(0, 255, photos[0].image.shape, dtype=np.uint8)
    with refused(ReconProblem.NO_OVERLAP, r"first photo \(front\.png\) shares too few .* retake"):
        cameras_from_motion([Photo("front.png", noise), *photos], height_mm=48.0)


def test_without_pycolmap_photos_that_the_ground_does_not_join_name_it_and_what_to_do(monkeypatch):
    monkeypatch.setattr(motion, "pycolmap", None)
    blank = [Photo(f"{i}.png", np.full((120, 160, 3), 90, np.uint8)) for i in range(4)]
    with refused(ReconProblem.MISSING_LIBRARY, r"needs pycolmap.*on the mat \(drupe mat\).*fruit\.ply"):
        cameras_from_motion(blank, height_mm=48.0)


def test_photos_with_common_features_but_one_viewpoint_are_refused_for_their_camera_poses():
    pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    cloth = cv2.GaussianBlur(rng.uniform(0, 255, (480, 640, 3)), (0, 0), 3)
    cloth = cv2.normalize(cloth, None, 0, 255, cv2.NORM_MINMAX)
    noisy = [np.clip(cloth + rng.normal(0, 2, cloth.shape), 0, 255).astype(np.uint8) for _ in range(4)]
    with refused(ReconProblem.NO_OVERLAP, "Features of the photos give camera poses for only 0 of 4 photos"):
        cameras_from_features([Photo(f"{i}.png", image) for i, image in enumerate(noisy)], height_mm=48.0)


class Redness:
    """Log odds of red pixels, as a fruit model's session gives them."""

    def run(self, names, feeds):
        return [np.clip(2000 * (feeds["images"][:, :1] - 154 / 255), -6, 6)]


EGG = Egg(x_mm=12.0, y_mm=-9.0)


def photos_on_similar_ground(cameras: list[Camera]) -> list[Photo]:
    """EGG on ground of nearly its colour."""
    v, u = np.mgrid[:180, :240]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    photos = []
    for camera in cameras:
        covered = EGG.covers(camera, pixels).reshape(180, 240, 1)
        image = np.where(covered, np.array([90, 112, 158]), np.array([90, 120, 150])).astype(np.uint8)
        photos.append(Photo(camera.name, image))
    return photos


def test_fruit_of_the_colour_of_its_ground_is_placed_with_the_fruit_model():
    """Skin and ground differ by less than ground may differ from its plate."""
    cameras = ring(9, width=240, height=180)
    photos = photos_on_similar_ground(cameras)
    with refused(ReconProblem.NO_FRUIT, "drupe found no fruit"):
        placed(photos, cameras, 48.0)
    world, (_, high_mm) = placed(photos, cameras, 48.0, FruitModel(SHIPPED, Redness()))
    middle = world[:3, :3] @ EGG.centre + world[:3, 3]
    assert (np.abs(middle[:2]) + EGG.semi_mm[:2] < high_mm[:2]).all()
    assert middle[2] == pytest.approx(EGG.centre[2], rel=0.1)


def test_cameras_from_features_place_the_fruit_with_the_fruit_model(monkeypatch):
    """COLMAP's reconstruction is replaced by true cameras and points of the ground."""
    cameras = ring(9, width=240, height=180)
    lens = SimpleNamespace(params=[cameras[0].focal_px, 120.0, 90.0, 0.0])
    ground = np.c_[np.random.default_rng(0).uniform(-80, 80, (400, 2)), np.zeros(400)]
    track = SimpleNamespace(length=lambda: 3)

    def image_of(camera: Camera) -> SimpleNamespace:
        pose = SimpleNamespace(matrix=lambda: camera.cam_from_world[:3])
        name = f"000{camera.name}"
        return SimpleNamespace(
            name=name, has_pose=True, camera_id=1, camera=lens, cam_from_world=lambda: pose
        )

    mapped = SimpleNamespace(
        num_reg_images=lambda: len(cameras),
        images=dict(enumerate(map(image_of, cameras))),
        points3D={k: SimpleNamespace(xyz=x, track=track) for k, x in enumerate(ground)},
        cameras={1: lens},
        compute_mean_reprojection_error=lambda: 0.5,
    )
    monkeypatch.setattr(motion, "pycolmap", object())
    monkeypatch.setattr(motion, "_mapped", lambda *_: mapped)
    model = FruitModel(SHIPPED, Redness())
    poses = cameras_from_features(photos_on_similar_ground(cameras), height_mm=48.0, model=model)
    assert len(poses.used) == len(cameras)
    apart = [np.linalg.norm(known[0].place - known[4].place) for known in (poses.cameras, cameras)]
    assert apart[0] == pytest.approx(apart[1], rel=0.1)


def test_a_first_photo_from_straight_above_is_refused():
    up, foot = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    with refused(ReconProblem.NO_OVERLAP, "looks straight down on the fruit"):
        upright(up, foot, np.array([10.0, 0.0, 200.0]))
    assert np.allclose(upright(up, foot, np.array([0.0, 50.0, 50.0]))[0, :3], [0, 1, 0])


ENDS_ITSELF = "import os, signal, recon.cameras.motion; os.kill(os.getpid(), signal.SIGTERM)"


def test_a_process_told_to_end_prints_no_stack() -> None:
    done = python(ENDS_ITSELF)
    assert done.returncode == -signal.SIGTERM
    assert "SIGTERM" not in done.stderr
    assert "stack trace" not in done.stderr


GIVEN = [f"IMG_{i}.jpg" for i in range(1, 8)]


def _ring(azimuth_deg):
    angle = np.radians(azimuth_deg)
    return np.stack([300 * np.cos(angle), 300 * np.sin(angle), np.full(len(angle), 100.0)], axis=1)


def test_a_side_without_photos_and_a_photo_that_joins_none_are_named():
    placed = [GIVEN[i] for i in (0, 1, 2, 3, 4, 6)]
    said = missing_views(
        placed, _ring([10.0, 50, 95, 140, 170, 330]), np.zeros(3), given=GIVEN, unplaced=[GIVEN[5]]
    )
    assert "take photos at 200, 240, 280 degrees" in said
    assert "between 160 and 320 degrees" in said
    assert "IMG_6.jpg overlaps too little" in said
    assert "between IMG_5.jpg and IMG_7.jpg" in said


@pytest.mark.parametrize("count", [6, 7], ids=["one left out for another reason", "all"])
def test_a_full_ring_lacks_nothing(count):
    around = _ring(np.arange(count) * 360 / count)
    assert missing_views(GIVEN[:count], around, np.zeros(3), given=GIVEN) == ""


def test_a_failure_comes_back_from_a_worker():
    back = pickle.loads(pickle.dumps(ReconFailure(ReconProblem.NO_OVERLAP, "x")))
    assert (back.problem, back.detail) == (ReconProblem.NO_OVERLAP, "x")
