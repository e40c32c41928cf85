"""`drupe check` names the photos to retake, of twelve small photos of a fruit of the shipped batch."""

import re
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import pytest
from small_batches import empty_batch

import pipeline.fruit.fruit_shape
from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.task import fruit_task
from pipeline.fruit.fruit_shape import fruit_shape
from pipeline.fruit.photographed import KeptMesh
from pipeline.run.checking import check
from recon.silhouettes.hull import ball

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
def batch(tmp_path, small):
    """A batch of N01 with these photos, with which nothing is wrong, and without a recording."""
    empty_batch(tmp_path, "N01", table="fruit_id,height_mm\nN01,55.3\n")
    (tmp_path / "fruits" / "N01" / "photos").mkdir()
    for name, image in small.items():
        write(tmp_path, name, image)
    (tmp_path / "mat.json").write_bytes((SAMPLE / "mat.json").read_bytes())
    return tmp_path


def write(batch, name, image):
    path = batch / "fruits" / "N01" / "photos" / name
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 92])


def said(batch, **options):
    """Problems of the photos, and whether each is a remark only."""
    problems = [problem for problem in check(batch, **options) if "N01/photos" in problem.file]
    return [(str(problem).replace(f"{batch}/", ""), problem.remark) for problem in problems]


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


def test_sound_photos_leave_nothing_to_say(batch):
    assert said(batch) == []


def test_each_spoilt_photo_is_named_with_what_to_do(batch, small):
    for name, (spoil, _) in SPOILT.items():
        write(batch, name, spoil(small[name]))
    problems = said(batch)
    for name, (_, expected) in SPOILT.items():
        (sentence,) = [text for text, _ in problems if name in text]
        assert re.search(expected, sentence)
    assert all(remark for _, remark in problems)
    assert said(batch, quick=True) == []


def test_photos_of_one_side_are_refused_with_where_to_stand(batch):
    for name in ("000.jpg", "002.jpg", "018.jpg", "022.jpg"):
        (batch / "fruits" / "N01" / "photos" / name).unlink()
    (sentence, remark) = said(batch)[0]
    assert "degrees, counted from 004.jpg to the right around the fruit: take photos at" in sentence
    assert remark


def test_an_unreadable_heic_is_named_in_a_quick_check_too(batch):
    (batch / "fruits" / "N01" / "photos" / "100.HEIC").write_bytes(HEIC.read_bytes()[:700])
    ((sentence, remark),) = said(batch, quick=True)
    assert sentence.startswith("fruits/N01/photos/100.HEIC: 100.HEIC in ")
    assert "is damaged or was cut short" in sentence
    assert not remark


def test_without_a_mat_nothing_is_said_of_the_views(batch):
    (batch / "mat.json").unlink()
    assert said(batch) == []


def kept_ball(mesh_from_fruit, *warnings):
    """A mesh of photos as it is stored."""
    directions, faces = ball(3)
    return KeptMesh(
        vertices=28.0 * directions, faces=faces, mesh_from_fruit=mesh_from_fruit, views=None, sd_mm=None,
        photo=np.zeros(1, np.uint8), outlines=np.zeros(0, np.uint8), skin=np.zeros(0, np.uint8),
        scale_sd=0.001, surface_sd_mm=0.1, quality={"views_used": 0}, warnings=warnings,
    )  # fmt: skip


def test_grading_warns_of_photos_that_are_not_used_and_grades_anew_when_they_change(batch):
    """The mesh is a ball: the photos are not what is tested."""
    place = batch / "fruits" / "N01" / "photos"
    results = Results(batch / "results")
    before = fruit_task(open_batch(batch), "N01", results)
    (place / "100.webp").write_bytes(b"RIFF1234WEBP" + bytes(50))
    (place / "101.jpg").symlink_to("nowhere.jpg")
    (place / "notes.txt").write_text("x")
    task = fruit_task(open_batch(batch), "N01", results)
    assert task.key != before.key
    task.results.claim()
    mesh = kept_ball(np.eye(4), "as before.")
    with mock.patch.object(pipeline.fruit.fruit_shape, "photographed", return_value=mesh):
        webp, link, *rest = fruit_shape(task).warnings
    assert webp.startswith("photos/: 100.webp is not used: drupe does not read WebP pictures")
    assert link.startswith("photos/: 101.jpg is not used: it is a link to nothing")
    assert "as before." in rest


def test_a_photographed_fruit_knows_its_place_on_the_mat_alone(batch):
    place = np.eye(4)
    place[:3, 3] = 3.0, -2.0, 0.4
    mesh = kept_ball(place)
    with mock.patch.object(pipeline.fruit.fruit_shape, "photographed", return_value=mesh):
        task = fruit_task(open_batch(batch), "N01", Results(batch / "results"))
        task.results.claim()
        np.testing.assert_array_equal(fruit_shape(task).mat_from_fruit, place)
        (batch / "mat.json").unlink()
        task = fruit_task(open_batch(batch), "N01", Results(batch / "results"))
        assert fruit_shape(task).mat_from_fruit is None
