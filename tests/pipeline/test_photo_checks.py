"""`drupe check`: models, photos to retake, and what is said of those not used."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from unittest import mock

import cv2
import h5py
import numpy as np
import pytest
from small_batches import DATA, batch_of_nectarines, empty_batch, run, times_force
from tiny_onnx import write_constant_model

import pipeline.fruit.fruit_shape
from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.task import fruit_task
from pipeline.fruit.fruit_shape import fruit_shape
from pipeline.fruit.photographed import KeptMesh, _lacking, _pictures, _skin, _unused_doubts
from pipeline.run import checking as checking
from pipeline.run.checking import check, implausible
from recon.cameras.camera import Camera
from recon.cameras.photos import Photo
from recon.checks.quality import ReconQuality
from recon.fruit_mesh import Reconstruction
from recon.learned import usable_model
from recon.learned.fruit_model import SIDE_PX
from recon.learned.onnx_session import opened
from recon.pit.placement import place_pit
from recon.pit.priors import load_prior
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import read_mesh, write_mesh
from reports.outlined_photos import NAME_PX, TILE_PX
from reports.photo import thumbnail_jpeg
from reports.skin_texture import HEIGHT_PX, UNSEEN, WIDTH_PX
from tactile.readers.recording import read_recording


@pytest.fixture
def batch(tmp_path):
    return batch_of_nectarines(tmp_path, "A", "B")


def said(batch):
    return [str(problem).replace(f"{batch}/", "") for problem in check(batch)]


def on_one_line(path):
    with h5py.File(path, "r+") as file:
        file["pads/left/rest_mm"][:, 1] = 0.0


def test_markers_on_a_line_are_said_and_hide_no_other_problem(batch):
    on_one_line(batch / "fruits" / "A" / "grasps" / "grasp-1.h5")
    (batch / "fruits" / "B" / "fruit.ply").write_bytes(b"no mesh")
    first, second = said(batch)
    assert first.startswith("fruits/A/grasps/grasp-1.h5: pads/left/rest_mm: found")
    assert "on one line" in first
    assert second.startswith("fruits/B/fruit.ply")


@pytest.mark.parametrize("fault", [ValueError("QH6013\n  of the library"), KeyError("x"), RuntimeError()])
def test_a_fault_of_drupe_itself_is_one_line_of_the_file_and_hides_no_other(batch, monkeypatch, fault):
    def faulty(path, **options):
        if path.parts[-3] == "A":
            raise fault
        return read_recording(path, **options)

    monkeypatch.setattr(checking, "read_recording", faulty)
    (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_bytes(b"nothing")
    first, second = said(batch)
    beginning = "fruits/A/grasps/grasp-1.h5: an internal error of drupe occurred while reading grasp-1.h5: "
    assert first.startswith(beginning + type(fault).__name__)
    assert "\n" not in first
    assert "of the library" not in first
    assert second.startswith("fruits/B/grasps/grasp-1.h5")


def with_model(batch, **shapes):
    """A constant model of the batch, by default one that `drupe` can use, and a photo instead of A's mesh."""
    side = shapes.get("side", SIDE_PX)
    outputs = {shapes.get("output", "fruit_log_odds"): np.zeros((1, 1, 2, 2))}
    write_constant_model(batch / "model.onnx", outputs, input_shape=("n", 3, side, side))
    with (batch / "batch.toml").open("a") as file:
        file.write('\n[recon]\ngeometry_model = "model.onnx"\n')
    (batch / "fruits" / "A" / "fruit.ply").unlink()
    (batch / "fruits" / "A" / "photos").mkdir()
    (batch / "fruits" / "A" / "photos" / "1.jpg").write_bytes(b"no picture")
    return batch / "model.onnx"


def said_of_model(batch):
    return [line for line in said(batch) if "recon.geometry_model" in line]


@pytest.mark.parametrize("damage", [lambda whole: whole[:-40], lambda whole: b"nonsense" * 99])
def test_a_damaged_model_is_named_before_the_first_fruit(batch, damage):
    model = with_model(batch)
    assert said_of_model(batch) == []
    model.write_bytes(damage(model.read_bytes()))
    (line,) = said_of_model(batch)
    assert line.startswith('batch.toml: "recon.geometry_model": The geometry model model.onnx is damaged')


@pytest.mark.parametrize(
    ("shapes", "side", "expected"),
    [({"side": 64}, 64, "(n, 3, 192, 192)"), ({"output": "depth"}, 192, "(1, S, 3, H, W)")],
)
def test_a_model_with_other_inputs_is_named_before_the_first_fruit(batch, shapes, side, expected):
    with_model(batch, **shapes)
    (line,) = said_of_model(batch)
    inputs = f"takes the inputs {{'images': ['n', 3, {side}, {side}]}}"
    assert f'{inputs}; expected one input "images" of shape {expected}' in line


def test_the_model_is_opened_once_and_only_for_photos(batch, monkeypatch):
    names, stages = [], []

    def counted(model, providers):
        names.append(model.name)
        return opened(model, providers)

    monkeypatch.setattr(usable_model, "opened", counted)
    with_model(batch)
    list(check(batch, report=stages.append))
    assert (names, stages[0]) == (["model.onnx"], "geometry model")
    shutil.copyfile(DATA / "fruit.ply", batch / "fruits" / "A" / "fruit.ply")
    list(check(batch, report=stages.append))
    assert (names, stages.count("geometry model")) == (["model.onnx"], 1)


def test_each_mesh_is_read_once(batch, monkeypatch):
    opened = []

    def counted(path):
        opened.append(path.relative_to(batch / "fruits").as_posix())
        return read_mesh(path)

    monkeypatch.setattr(checking, "read_mesh", counted)
    vertices, faces = place_pit(*read_mesh(DATA / "fruit.ply"), load_prior("nectarine"))
    write_mesh(batch / "fruits" / "B" / "pit.ply", vertices, faces)
    assert said(batch) == []
    assert sorted(opened) == ["A/fruit.ply", "B/fruit.ply", "B/pit.ply"]


def test_grade_ends_by_the_rules_that_check_says(batch):
    """One slip in the table, one in a mesh: the sentences are the same."""
    (batch / "fruits.csv").write_text("fruit_id,mass_g\nA,0.1\nB,\n")
    vertices, faces = read_mesh(DATA / "fruit.ply")
    write_mesh(batch / "fruits" / "B" / "fruit.ply", 0.001 * vertices, faces)
    opened = open_batch(batch)
    ended = [implausible(opened, row) for row in opened.rows]
    assert all(ended)
    checked = [problem.sentence.removeprefix("A: ") for problem in check(batch) if problem.implausible]
    assert checked == ended


def checked(batch):
    """The command's exit status, and what it prints."""
    status, text = run("check", batch)
    return status, text.replace(f"{batch}/", "")


def with_pit(batch, shift_mm):
    vertices, faces = place_pit(*read_mesh(DATA / "fruit.ply"), load_prior("nectarine"))
    write_mesh(batch / "fruits" / "A" / "pit.ply", vertices + np.array([shift_mm, 0.0, 0.0]), faces)


@pytest.mark.parametrize(
    ("shift_mm", "status", "line", "last"),
    [
        (0.3, 0, "^$", "0 problems found in {}"),
        (
            8.0,
            2,
            "^fruits/A/pit.ply: pit.ply lies 8.0 mm from the expected place of a nectarine's pit",
            "1 problem found in {}",
        ),
        (
            4.0,
            4,
            "^fruits/A/pit.ply: pit.ply lies 4.0 mm from the expected place .*The mesh in pit.ply is "
            r"shifted, uses another frame than fruit.ply.*E will be in doubt\.$",
            "0 problems found in {}, and 1 finding that will put E in doubt",
        ),
    ],
)
def test_a_pit_is_in_order_refused_or_doubted_as_grading_does(batch, shift_mm, status, line, last):
    with_pit(batch, shift_mm)
    ended, text = checked(batch)
    assert ended == status
    *lines, final = text.splitlines()
    assert re.search(line, "".join(lines))
    assert final == last.format(batch)


def test_a_pit_is_judged_where_the_settings_move_it(batch):
    """As grading does: 4 mm back to the middle, by what the grasps showed."""
    with_pit(batch, 4.0)
    with (batch / "batch.toml").open("a") as file:
        file.write(
            '[[mismatch]]\neffect = "pit_offset"\nfruits = ["A"]\n'
            "parameters = { offset_mm = [-4.0, 0.0, 0.0] }\n"
        )
    assert checked(batch)[0] == 0


def test_a_gain_that_grading_doubts_is_said(batch):
    with h5py.File(batch / "fruits" / "B" / "grasps" / "grasp-1.h5", "r+") as file:
        times_force(file, 1.4)
    status, text = checked(batch)
    assert status == 4
    line, _ = text.splitlines()
    assert line.startswith("fruits/B/grasps/grasp-1.h5: ")
    assert "1.4" in line
    assert line.endswith("E will be in doubt.")
    (batch / "fruits" / "A" / "fruit.ply").write_bytes(b"no mesh")
    assert checked(batch)[0] == 2


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("fruits/A", "is the folder of one fruit; give the batch, {}."),
        ("fruits/AA", "does not exist; give an existing batch folder."),
        ("loop", "does not exist; give an existing batch folder."),
    ],
)
def test_a_place_that_is_no_batch_is_refused_and_a_fruits_own_leads_to_its_batch(batch, place, said):
    (batch / "loop").symlink_to("loop")
    (problem,) = check(batch / place)
    assert problem.sentence == said.format(batch)


def test_problems_of_the_batch_come_before_any_fruit_is_read(batch):
    (batch / "fruits" / "stray" / "photos").mkdir(parents=True)
    stages = []
    problems = check(batch, quick=True, report=stages.append)
    assert "is not in fruits.csv" in next(problems).sentence
    assert not stages
    list(problems)
    assert stages == ["A (1 of 2)", "B (2 of 2)"]


def test_a_slip_in_the_path_is_told_before_anything_else(batch, drupe):
    ran = drupe("check", batch.with_name("nowhere"))
    assert (ran.status, ran.out) == (2, "")
    assert "nowhere: does not exist; give an existing batch folder." in ran.err


HEIC = Path(__file__).resolve().parents[1] / "data" / "heic" / "ten-bits.heic"
SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "data" / "nectarines"


@pytest.fixture(scope="module")
def small():
    """Every second photo of N01, half as wide and high."""
    paths = sorted((SAMPLE / "fruits" / "N01" / "photos").glob("*.jpg"))[::2]
    return {
        path.name: cv2.resize(cv2.imread(str(path)), (640, 480), interpolation=cv2.INTER_AREA)
        for path in paths
    }


@pytest.fixture
def photo_batch(tmp_path, small):
    """A batch of N01 with these photos, with which nothing is wrong, and without a recording."""
    empty_batch(tmp_path, "N01", table="fruit_id,height_mm\nN01,55.3\n")
    (tmp_path / "fruits" / "N01" / "photos").mkdir()
    for name, image in small.items():
        write(tmp_path, name, image)
    (tmp_path / "mat.json").write_bytes((SAMPLE / "mat.json").read_bytes())
    return tmp_path


def write(photo_batch, name, image):
    path = photo_batch / "fruits" / "N01" / "photos" / name
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 92])


def said_of_photos(photo_batch, **options):
    """Problems of the photos, and whether each is a remark only."""
    problems = [problem for problem in check(photo_batch, **options) if "N01/photos" in problem.file]
    return [(str(problem).replace(f"{photo_batch}/", ""), problem.remark) for problem in problems]


def bare(image):
    """The photo with its mat covered, but for the middle."""
    out = np.full_like(image, 120)
    out[170:320, 230:410] = image[170:320, 230:410]
    return out


SPOILT = {
    "002.jpg": (lambda image: cv2.GaussianBlur(image, (0, 0), 2.0), r"002\.jpg: blurred .* retake it"),
    "006.jpg": (lambda image: image // 4, r"006\.jpg: too dark .* retake it with more exposure"),
    "010.jpg": (
        lambda image: cv2.convertScaleAbs(image, alpha=2.5),
        r"010\.jpg: overexposed .* retake it with less exposure",
    ),
    "014.jpg": (bare, r"Left out: 014\.jpg: shows .* tags of the mat.* retake it"),
    "018.jpg": (lambda image: np.ascontiguousarray(image[:, ::-1]), r"Left out: 018\.jpg: mirrored"),
}


def test_sound_photos_leave_nothing_to_say_nor_do_any_of_the_views_without_a_mat(photo_batch):
    assert said_of_photos(photo_batch) == []
    (photo_batch / "mat.json").unlink()
    assert said_of_photos(photo_batch) == []


def test_each_spoilt_photo_is_named_with_what_to_do(photo_batch, small):
    for name, (spoil, _) in SPOILT.items():
        write(photo_batch, name, spoil(small[name]))
    problems = said_of_photos(photo_batch)
    for name, (_, expected) in SPOILT.items():
        (sentence,) = [text for text, _ in problems if name in text]
        assert re.search(expected, sentence)
    assert all(remark for _, remark in problems)
    assert said_of_photos(photo_batch, quick=True) == []


def test_photos_of_one_side_are_refused_with_where_to_stand(photo_batch):
    for name in ("000.jpg", "002.jpg", "018.jpg", "022.jpg"):
        (photo_batch / "fruits" / "N01" / "photos" / name).unlink()
    (sentence, remark) = said_of_photos(photo_batch)[0]
    assert "degrees, counted from 004.jpg to the right around the fruit: take photos at" in sentence
    assert remark


def test_an_unreadable_heic_is_named_in_a_quick_check_too(photo_batch):
    (photo_batch / "fruits" / "N01" / "photos" / "100.HEIC").write_bytes(HEIC.read_bytes()[:700])
    ((sentence, remark),) = said_of_photos(photo_batch, quick=True)
    assert sentence.startswith("fruits/N01/photos/100.HEIC: The photo 100.HEIC in ")
    assert "is damaged or was cut short" in sentence
    assert not remark


def kept_ball(mesh_from_fruit, *warnings):
    """A mesh of photos as it is stored."""
    directions, faces = ball(3)
    return KeptMesh(
        vertices=28.0 * directions, faces=faces, mesh_from_fruit=mesh_from_fruit, views=None, sd_mm=None,
        photo=np.zeros(1, np.uint8), outlines=np.zeros(0, np.uint8), skin=np.zeros(0, np.uint8),
        scale_sd=0.001, surface_sd_mm=0.1, quality={"views_used": 0}, warnings=warnings,
    )  # fmt: skip


def test_grading_warns_of_photos_that_are_not_used_and_grades_anew_when_they_change(photo_batch):
    """The mesh is a ball: the photos are not what is tested."""
    place = photo_batch / "fruits" / "N01" / "photos"
    results = Results(photo_batch / "results")
    before = fruit_task(open_batch(photo_batch), "N01", results)
    (place / "100.webp").write_bytes(b"RIFF1234WEBP" + bytes(50))
    (place / "101.jpg").symlink_to("nowhere.jpg")
    (place / "notes.txt").write_text("x")
    task = fruit_task(open_batch(photo_batch), "N01", results)
    assert task.key != before.key
    task.results.claim()
    mesh = kept_ball(np.eye(4), "as before.")
    with mock.patch.object(pipeline.fruit.fruit_shape, "photographed", return_value=mesh):
        webp, link, *rest = fruit_shape(task).warnings
    assert webp.startswith("photos/: 100.webp is not used: drupe does not read WebP pictures")
    assert link.startswith("photos/: 101.jpg is not used: it is a link to nothing")
    assert "as before." in rest


def test_a_photographed_fruit_knows_its_place_on_the_mat_alone(photo_batch):
    place = np.eye(4)
    place[:3, 3] = 3.0, -2.0, 0.4
    mesh = kept_ball(place)
    with mock.patch.object(pipeline.fruit.fruit_shape, "photographed", return_value=mesh):
        task = fruit_task(open_batch(photo_batch), "N01", Results(photo_batch / "results"))
        task.results.claim()
        np.testing.assert_array_equal(fruit_shape(task).mat_from_fruit, place)
        (photo_batch / "mat.json").unlink()
        task = fruit_task(open_batch(photo_batch), "N01", Results(photo_batch / "results"))
        assert fruit_shape(task).mat_from_fruit is None


NAMES = [f"{i}.jpg" for i in range(6)]


def looking_in(name, azimuth):
    away = np.array([np.cos(azimuth), np.sin(azimuth), 0.4])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    ahead = -away / np.linalg.norm(away)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ (300 * away)
    return Camera(name=name, width_px=96, height_px=72, focal_px=120.0, k1=0.0, cam_from_world=pose)


@pytest.fixture
def made():
    """Four of six photos used; the fifth could not be placed, the sixth was not even tried."""
    vertices, faces = ball(2)
    return Reconstruction(
        vertices=20 * vertices, faces=faces, scale_sd=0.01, surface_sd_mm=0.1,
        quality=ReconQuality(k1=0.0), warnings=(), frame="shape",
        cameras=tuple(looking_in(name, np.pi / 2 * i) for i, name in enumerate(NAMES[:4])),
        unplaced=(NAMES[4],),
    )  # fmt: skip


def test_only_a_photo_that_could_not_be_joined_shares_too_little_and_on_a_mat_none(made):
    said_of_photos = _lacking(made, NAMES)
    assert "4.jpg overlaps too little" in said_of_photos
    assert "5.jpg shares" not in said_of_photos
    assert "overlaps too little" not in _lacking(replace(made, frame="mat"), NAMES)


@pytest.mark.parametrize(("frame", "asked"), [("mat", "the mat in view"), ("shape", "the ground around it")])
def test_a_photo_left_out_is_asked_for_again_with_what_there_is(made, frame, asked):
    photos = [Photo(name=n, image=np.full((72, 96, 3), 90, np.uint8), focal_px=None) for n in NAMES[:5]]
    (said_of_photos,) = _unused_doubts(photos, replace(made, frame=frame))
    assert said_of_photos.startswith("drupe left out 4.jpg:")
    assert asked in said_of_photos
    assert ("mat" in said_of_photos) == (frame == "mat")


def test_a_photo_is_shown_with_its_outline_where_there_is_one(made):
    photos = [Photo(name=n, image=np.full((72, 96, 3), 90, np.uint8), focal_px=None) for n in NAMES[:4]]
    images = [photo.image for photo in photos]
    square = np.array([[20.0, 20.0], [60.0, 20.0], [60.0, 50.0], [20.0, 50.0]])
    outlined = replace(made, outlines=(np.zeros((0, 2)), square, square, square))
    photo, sheet = _pictures(photos[0], images, outlined)
    decoded = cv2.imdecode(np.frombuffer(sheet, np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == (TILE_PX + NAME_PX, 3 * TILE_PX, 3)
    assert photo != _pictures(photos[0], images, made)[0]
    assert _pictures(photos[0], images, made) == (thumbnail_jpeg(photos[0].image), b"")


def with_hollow(towards):
    """Distance of a fruit's skin from its middle in unit directions: a deep hollow at the stem, mm."""
    return 30.0 - 14.0 * np.exp(-((np.arccos(np.clip(towards[..., 2], -1, 1)) / 0.3) ** 2))


def depth_on_the_way(start, end):
    """How deep the straight way from points of the skin to `end` goes into the fruit, at most, mm."""
    way = np.linspace(0.02, 0.5, 300)[:, None]
    depth = np.full(len(start), -np.inf)
    for k, point in enumerate(start):
        places = point + way * (end - point)
        away = np.linalg.norm(places, axis=1)
        depth[k] = np.max(with_hollow(places / away[:, None]) - away)
    return depth


def test_skin_that_the_fruit_itself_hides_is_grey(made):
    """One low camera: it sees the near skin, and of the hollow the far wall; by steps along each line."""
    sphere, faces = ball(5)
    camera = looking_in("a.jpg", 0.0)
    hollow = replace(made, vertices=sphere * with_hollow(sphere)[:, None], faces=faces, cameras=(camera,))
    red = np.full((camera.height_px, camera.width_px, 3), (20, 20, 220), np.uint8)
    coded = np.frombuffer(_skin([red], [camera], hollow), np.uint8)
    texture = cv2.imdecode(coded, cv2.IMREAD_COLOR).astype(float)
    row, column = (part.ravel() for part in np.mgrid[1:HEIGHT_PX:3, 0:WIDTH_PX:4])
    polar, longitude = np.pi * (row + 0.5) / HEIGHT_PX, 2 * np.pi * (column + 0.5) / WIDTH_PX
    towards = np.column_stack(
        [np.sin(polar) * np.cos(longitude), np.sin(polar) * np.sin(longitude), np.cos(polar)]
    )
    depth = depth_on_the_way(with_hollow(towards)[:, None] * towards, camera.place)
    is_red = texture[row, column, 2] - texture[row, column, 0] > 100
    is_grey = np.abs(texture[row, column] - UNSEEN).max(axis=1) < 30
    in_hollow = polar < 0.45
    assert (depth[in_hollow] > 1.0).sum() > 100
    assert not is_red[in_hollow & (depth > 1.0)].any()
    assert is_grey[in_hollow & (depth > 2.0)].all()  # nearer, the JPEG mixes colours
    facing = towards @ camera.place / np.linalg.norm(camera.place)
    assert is_red[(facing > 0.6) & ~in_hollow & (depth < -0.3)].all()
    assert (is_red & in_hollow).sum() > 20
