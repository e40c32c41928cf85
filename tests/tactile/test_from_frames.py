"""A raw grasp becomes a recording, and whatever is wrong with it is said by file and field."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_gel import drawn, grid
from jaxtyping import Float
from raw_folder import (
    CENTRE,
    DEPTH_MM,
    FRAMES,
    PRESS,
    PX_PER_MM,
    replaced,
    shear,
    write_camera,
    write_log,
    write_picture,
    write_raw,
)
from refusals import refused
from scipy.spatial import cKDTree

from tactile.from_frames import recording_of
from tactile.plain_jaw import has_plain_jaw
from tactile.readers.raw_grasp import files_of, read_raw_grasp
from tactile.readers.recording import Converted, GelPad, IndenterPad, read_recording, write_recording
from tactile.tactile_failure import TactileFailure, TactileProblem

P = TactileProblem
HALF_PITCH = np.array([15.0, 0.0])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_raw(tmp_path_factory.mktemp("raw") / "grasp-1")


@pytest.fixture(scope="module")
def converted(whole: Path) -> Converted:
    return recording_of(read_raw_grasp(whole))


@pytest.fixture
def raw(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "grasp-1"))


def gel(converted: Converted, pad: int = 0) -> GelPad:
    return converted.recording.pads[pad]


def test_displaced_markers_are_seen_where_the_pictures_have_them(converted: Converted) -> None:
    pad = gel(converted)
    away, order = cKDTree((grid() - CENTRE) / PX_PER_MM).query(pad.rest_mm[:, :2])
    where = pad.rest_mm + pad.displacement_mm
    seen = CENTRE + PX_PER_MM * DEPTH_MM * where[..., :2] / (DEPTH_MM + where[..., 2:])
    error = seen - np.stack([shear(t) for t in range(FRAMES)])[:, order]
    assert away.max() < 0.01
    assert len(pad.rest_mm) == len(grid())
    assert np.sqrt((error**2).mean()) < 0.04


def test_pads_move_by_half_of_the_aperture_each(converted: Converted) -> None:
    left, right = gel(converted, 0), gel(converted, 1)
    np.testing.assert_allclose(left.pose[:, 0, 3], -30 + 0.05 * np.arange(FRAMES), atol=1e-9)
    np.testing.assert_allclose(right.pose[:, 0, 3], 30 - 0.05 * np.arange(FRAMES), atol=1e-9)
    np.testing.assert_allclose(converted.recording.aperture_mm, 60 - 0.1 * np.arange(FRAMES))


def test_a_shear_to_the_right_pushes_the_fruit_back_to_the_left(converted: Converted) -> None:
    force = gel(converted).force_N[-1].sum(axis=0)
    assert force[0] < 0
    assert force[1] < 0


def test_nothing_is_noted_of_a_sound_grasp(converted: Converted) -> None:
    assert converted.notes == ()


def spoil(path: str, *, old: str = "", new: str = "") -> Callable[[Path], None]:
    return lambda folder: replaced(folder / path, old, new)


def without(path: str) -> Callable[[Path], None]:
    return lambda folder: (folder / path).unlink()


def cut(path: str) -> Callable[[Path], None]:
    def act(folder: Path) -> None:
        whole = (folder / path).read_bytes()
        (folder / path).write_bytes(whole[: len(whole) // 2])

    return act


def painted(path: str, picture: np.ndarray) -> Callable[[Path], None]:
    return lambda folder: write_picture(folder / path, picture)


def swapped(folder: Path) -> None:
    (folder / "left").rename(folder / "x")
    (folder / "right").rename(folder / "left")
    (folder / "x").rename(folder / "right")


def test_a_jump_that_a_pitch_more_or_less_fits_as_well_is_said_with_its_frame(raw: Path) -> None:
    """The right pad's grid goes on beyond the picture, and all of it moves by half a pitch at once."""
    shifts = np.array([[dx, dy] for dx in (-270.0, 0.0, 270.0) for dy in (-210.0, 0.0, 210.0)])
    wide = (grid()[None] + shifts[:, None]).reshape(-1, 2)
    text = (raw / "right.toml").read_text()
    (raw / "right.toml").write_text(text[: text.index("[markers]")])
    write_picture(raw / "right/reference.png", drawn(wide, noise=1.0, seed=91))
    for t in range(FRAMES):
        moved = wide + (HALF_PITCH if t >= 5 else 0.0)
        write_picture(raw / f"right/frame_{t:06d}.png", drawn(moved, noise=1.0, seed=10 * t + 1))
    conversion = recording_of(read_raw_grasp(raw))
    assert any(
        "right: frame 5 (0.250 s): nearly all markers move at once" in note for note in conversion.notes
    )
    np.testing.assert_array_equal(gel(conversion, 0).certainty, 1.0)
    certainty = gel(conversion, 1).certainty
    assert (certainty[:5] == 1).all()
    assert (certainty[5:] < 1).all()


WHITE = np.full((240, 320, 3), 255, dtype=np.uint8)
FAULTS: list[tuple[str, Callable[[Path], None], TactileProblem, str]] = [
    ("no reference", without("left/reference.png"), P.UNREADABLE_FRAMES,
     "left/reference.png: found no such file"),
    ("white reference", painted("left/reference.png", WHITE), P.SATURATED,
     "left: reference: found 100%"),
    ("white frame", painted("left/frame_000005.png", WHITE), P.SATURATED,
     "left: frame 5: found 100%"),
    ("markers gone", painted(f'left/frame_{6:06d}.png', drawn(grid()[:20], noise=1.0)), P.MARKERS_LOST,
     "left: frame 6: found 3"),
    ("frames dropped", without("left/frame_000003.png"), P.UNREADABLE_FRAMES,
     "left: found 7 frames, expected 8"),
    ("picture cut", cut("left/frame_000004.png"), P.UNREADABLE_FRAMES,
     "left/frame_000004.png: found a damaged"),
    ("no log", without("log.csv"), P.UNREADABLE_FRAMES,
     "log.csv: found no such file"),
    ("no times", spoil("log.csv", old="time_s", new="t"), P.UNREADABLE_FRAMES,
     "log.csv: time_s: found the columns"),
    ("time missing", spoil("log.csv", old="0.1,59.8", new=",59.8"), P.UNREADABLE_FRAMES,
     "log.csv: time_s: found nothing in row 4"),
    ("time back", spoil("log.csv", old="0.1,59.8", new="0.01,59.8"), P.UNREADABLE_FRAMES,
     "time_s: found 0.01 s in row 4 after 0.05 s"),
    ("no word", spoil("log.csv", old="59.8", new="open"), P.UNREADABLE_FRAMES,
     'aperture_mm: found "open" in row 4'),
    ("other size", painted("left/frame_000002.png", WHITE[:100, :100] // 2), P.UNREADABLE_FRAMES,
     "frame 2 of 100 x 100"),
    ("wrong sensor", spoil("left.toml", old="columns = 9", new="columns = 14"), P.WRONG_SENSOR,
     "belongs to this sensor and that the pads are not swapped"),
    ("wrong size", spoil("left.toml", old="[320, 240]", new="[640, 480]"), P.WRONG_SENSOR,
     "320 x 240 pixels, expected 640"),
    ("no sensor file", without("left.toml"), P.UNREADABLE_FRAMES,
     "pads.left.sensor: found no file left.toml"),
    ("unknown key", spoil("grasp.toml", old="fruit_id", new="fruit"), P.UNREADABLE_FRAMES,
     "grasp.toml: fruit: found a key"),
]  # fmt: skip


@pytest.mark.parametrize(("act", "problem", "says"), [f[1:] for f in FAULTS], ids=[f[0] for f in FAULTS])
def test_a_fault_is_named(raw: Path, act: Callable[[Path], None], problem: TactileProblem, says: str) -> None:
    act(raw)
    with refused(problem, re.escape(says)):
        recording_of(read_raw_grasp(raw))


def test_pads_swapped_by_serial_are_said_to_be(raw: Path) -> None:
    replaced(raw / "grasp.toml", 'sensor = "left.toml"', 'sensor = "left.toml"\nserial = "right"')
    with pytest.raises(TactileFailure, match="it is the right pad's: the pads are swapped"):
        read_raw_grasp(raw)


def test_a_doubled_frame_is_left_out_and_said_as_swapped_pads_without_a_serial_are_and_uneven_times_are_not(
    raw: Path,
) -> None:
    for pad in ("left", "right"):
        replaced(raw / f"{pad}.toml", f'serial = "{pad}"', "")
    swapped(raw)
    shutil.copy(raw / "left/frame_000003.png", raw / "left/frame_000004.png")
    rows = (raw / "log.csv").read_text().splitlines()
    late = [
        row if k < 5 else f"{float(row.split(',')[0]) + 0.5},{row.split(',', 1)[1]}"
        for k, row in enumerate(rows)
    ]
    (raw / "log.csv").write_text("\n".join(late))
    conversion = recording_of(read_raw_grasp(raw))
    assert len(conversion.recording.time_s) == FRAMES - 1
    said = " ".join(conversion.notes)
    assert "drupe cannot detect swapped pads with similar markers" in said
    assert "grasp-1/left: 1 frames repeat the one before" in said
    assert "missing" not in said


def test_dropped_frames_with_numbers_in_the_log_are_said_and_a_torn_marker_is_filled_from_its_neighbours(
    raw: Path,
) -> None:
    for pad in ("left", "right"):
        for frame in (4, 5):
            (raw / pad / f"frame_{frame:06d}.png").unlink()
    rows = (raw / "log.csv").read_text().splitlines()
    numbered = [f"{k - 1},{row}" if k else f"frame,{row}" for k, row in enumerate(rows)]
    (raw / "log.csv").write_text("\n".join(numbered))
    for t in (3, 6, 7):
        shown = shear(t)
        shown[31] = np.nan
        write_picture(raw / f"left/frame_{t:06d}.png", drawn(shown, noise=1.0, seed=t))
    conversion = recording_of(read_raw_grasp(raw))
    np.testing.assert_allclose(conversion.recording.time_s, [0.0, 0.05, 0.1, 0.15, 0.3, 0.35])
    said = " ".join(conversion.notes)
    assert "about 2 frames are missing in 1 gaps, the first after 0.150 s" in said
    assert "left: 1 of 63 markers disappeared (the first at 0.100 s)" in said
    assert np.isfinite(gel(conversion).displacement_mm).all()


def test_a_pad_with_its_own_clock_is_put_on_the_logs(raw: Path) -> None:
    stamps = [f"{t},{0.05 * t + 6.0}" for t in range(FRAMES)]
    (raw / "right/times.csv").write_text("\n".join(["frame,time_s", *stamps]))
    with pytest.raises(TactileFailure, match=r"right: found frames from 6 to 6.35 s.*set time_offset_s"):
        read_raw_grasp(raw)
    replaced(raw / "grasp.toml", 'sensor = "right.toml"', 'sensor = "right.toml"\ntime_offset_s = 6.0')
    np.testing.assert_allclose(read_raw_grasp(raw).pads[1].time_s, 0.05 * np.arange(FRAMES), atol=1e-12)


def pictures_of(raw: Path) -> np.ndarray:
    """Every picture of the left pad."""
    return np.array([*read_raw_grasp(raw).pads[0].view.pictures.frames()], dtype=float)


def test_a_video_stands_for_a_folder_and_a_cut_one_is_refused(raw: Path) -> None:
    expected = pictures_of(raw)
    for pad in ("left", "right"):
        writer = cv2.VideoWriter(str(raw / f"{pad}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (320, 240))
        for frame in sorted((raw / pad).glob("frame_*.png")):
            writer.write(cv2.imread(str(frame)))
            frame.unlink()
        writer.release()
    assert np.abs(pictures_of(raw) - expected).mean() < 2.0
    cut("left.avi")(raw)
    with refused(P.UNREADABLE_FRAMES, r"left\.avi: found .*copy it again"):
        recording_of(read_raw_grasp(raw))


def test_jpeg_frames_filled_up_with_zeros_are_read_and_cut_ones_refused(raw: Path) -> None:
    expected = pictures_of(raw)
    for frame in sorted(raw.glob("*/frame_*.png")):
        coded = cv2.imencode(".jpg", cv2.imread(str(frame)), [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        frame.with_suffix(".jpg").write_bytes(coded + b"\0" * 300)
        frame.unlink()
    assert np.abs(pictures_of(raw) - expected).mean() < 2.0
    cut("left/frame_000004.jpg")(raw)
    with pytest.raises(TactileFailure, match=r"left/frame_000004\.jpg: found a damaged picture"):
        recording_of(read_raw_grasp(raw))


LEFT = 'sensor = "left.toml"'


@pytest.fixture(scope="module")
def in_batch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A grasp in a batch, which also has a clip of the empty left gel; the grasp's own reference is gone."""
    batch = tmp_path_factory.mktemp("made") / "batch"
    folder = write_raw(batch / "fruits" / "f1" / "grasps" / "grasp-1")
    (batch / "batch.toml").write_text("")
    for t in range(4):
        write_picture(batch / "empty" / f"frame_{t:06d}.png", drawn(grid(), light=1.0 + 0.1 * t))
    (folder / "left/reference.png").unlink()
    write_picture(batch.parent / "secret.png", drawn(grid()))
    return batch


@pytest.fixture
def grasp(in_batch: Path, tmp_path: Path) -> Path:
    shutil.copytree(in_batch.parent, tmp_path / "made")
    return tmp_path / "made" / "batch" / "fruits" / "f1" / "grasps" / "grasp-1"


def names(grasp: Path, line: str) -> Path:
    replaced(grasp / "grasp.toml", LEFT, f"{LEFT}\n{line}")
    return grasp


@pytest.mark.parametrize(
    ("lines", "light"),
    [
        ('reference = "../../../../empty"', 1.15),
        ('reference = "../../../../empty"\nreference_frames = [3, 4]', 1.3),
        ('reference = "../../../../empty/frame_000002.png"', 1.2),
    ],
)
def test_a_clip_of_the_empty_gel_is_the_reference_by_its_mean(grasp: Path, lines: str, light: float) -> None:
    """Over the mean grey level of the clip's first frame."""
    picture = read_raw_grasp(names(grasp, lines)).pads[0].view.reference
    assert picture.mean() / drawn(grid()).mean() == pytest.approx(light, abs=0.01)


def test_each_pad_has_its_own_reference(grasp: Path) -> None:
    names(grasp, "reference_frames = [0, 2]")
    left, right = read_raw_grasp(grasp).pads
    assert not np.array_equal(left.view.reference, right.view.reference)


REFUSED: list[tuple[str, str, str]] = [
    ("nothing named", "", "or frames of it (reference_frames"),
    ("out of the batch", 'reference = "../../../../../secret.png"',
     "pads.left.reference: found ../../../../../secret.png, which leads out of the batch, expected a file or "
     "folder inside the batch (batch)"),
    ("absolute", 'reference = "/etc/hostname"', "leads out of the batch"),
    ("not there", 'reference = "../../../../full.png"', "found no such file, expected a picture of the"),
    ("no such clip", 'reference = "../../../../empty.avi"', "empty.avi: found no such folder or video"),
    ("picture and frames", 'reference = "../../../../empty/frame_000002.png"\nreference_frames = [0, 1]',
     "beside reference_frames, expected a clip"),
    ("frames past the clip", 'reference = "../../../../empty"\nreference_frames = [2, 5]',
     "pads.left.reference_frames: found [2, 5] of 4 frames"),
    ("no frames", f"reference_frames = [{FRAMES}, {FRAMES}]", "found [8, 8] of 8 frames"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "says"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED])
def test_what_is_no_reference_is_refused_by_file_and_field(grasp: Path, line: str, says: str) -> None:
    with refused(TactileProblem.UNREADABLE_FRAMES, re.escape(says)):
        read_raw_grasp(names(grasp, line))


def test_a_link_out_of_the_batch_is_not_followed(grasp: Path) -> None:
    (grasp / "left" / "reference-far.png").symlink_to(grasp.parents[4] / "secret.png")
    with pytest.raises(TactileFailure, match="leads out of the batch"):
        read_raw_grasp(names(grasp, 'reference = "left/reference-far.png"'))


def test_the_files_of_a_grasp_hold_the_clip_that_it_names_and_nothing_outside_the_batch(grasp: Path) -> None:
    clip = grasp.parents[3] / "empty"
    assert not any(path.parent.name == "empty" for path in files_of(grasp))
    held = {path.resolve() for path in files_of(names(grasp, 'reference = "../../../../empty"'))}
    assert {path.resolve() for path in clip.iterdir()} <= held
    replaced(grasp / "grasp.toml", "../../../../empty", "../../../../../secret.png")
    assert not any(path.name == "secret.png" for path in files_of(grasp))


PLAIN = """[pads.right]
plain = true
pose = [[0, 0, -1, 30], [1, 0, 0, 0], [0, -1, 0, 40], [0, 0, 0, 1]]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = write_raw(tmp_path_factory.mktemp("raw") / "grasp-1")
    text = (made / "grasp.toml").read_text()
    (made / "grasp.toml").write_text(text[: text.index("[pads.right]")] + PLAIN)
    shutil.rmtree(made / "right")
    return made


def test_it_becomes_a_plate_with_the_gels_force(folder: Path, tmp_path: Path) -> None:
    write_recording(tmp_path / "g.h5", recording_of(read_raw_grasp(folder)).recording)
    recording = read_recording(tmp_path / "g.h5")
    left, right = recording.pads
    assert isinstance(left, GelPad)
    assert isinstance(right, IndenterPad)
    assert has_plain_jaw(recording)
    on_fruit = np.einsum("tij,tnj->ti", left.pose[:, :3, :3], left.force_N)
    assert right.force_z_N == pytest.approx(-np.einsum("tj,tj->t", right.pose[:, :3, 2], on_fruit), abs=1e-5)
    closing = np.diff(recording.aperture_mm)
    assert np.diff(right.pose[:, 0, 3]) == pytest.approx(0.5 * closing)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (PLAIN.replace("plain = true", 'plain = "yes"'), "plain: found 'yes', expected true"),
        (PLAIN + 'sensor = "left.toml"\n', "sensor"),
        (PLAIN.replace("30]", "30, 1]"), "pose"),
        (PLAIN.replace("right", "left") + PLAIN, "one jaw with a gel at least"),
    ],
)
def test_what_a_plain_jaw_cannot_be_is_said(folder: Path, tmp_path: Path, lines: str, words: str) -> None:
    copied = Path(shutil.copytree(folder, tmp_path / "grasp-1"))
    text = (copied / "grasp.toml").read_text()
    (copied / "grasp.toml").write_text(text[: text.index(lines.split("\n")[0])] + lines)
    with pytest.raises(TactileFailure, match=words):
        read_raw_grasp(copied)


FOCAL_PX, STEREO_FRAMES = 240.0, 5
X, Y = np.meshgrid(np.arange(-4, 5) * 1.8, np.arange(-3, 4) * 1.8)
REST = np.stack([X.ravel(), Y.ravel(), np.zeros(63)], axis=1)
AWAY = np.arctan2(6.0, 16.0)
TURN = np.array([[np.cos(AWAY), 0, -np.sin(AWAY)], [0, 1, 0], [np.sin(AWAY), 0, np.cos(AWAY)]])
CAMERAS = ((np.eye(3), np.array([0.0, 0.0, -16.0])), (TURN, np.array([6.0, 0.0, -16.0])))


def press(frame: int) -> Float[np.ndarray, "n 3"]:
    """Places of the markers: a dent that also spreads."""
    dent = 0.1 * max(frame - 1, 0) * np.exp(-(REST[:, 0] ** 2 + REST[:, 1] ** 2) / 2 / 3.0**2)
    return REST + dent[:, None] * np.stack([0.1 * REST[:, 0], 0.1 * REST[:, 1], -np.ones(63)], axis=1)


def seen(camera: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Pinhole: pixels of points of the gel frame."""
    turn, place = CAMERAS[camera]
    local = (points - place) @ turn
    return FOCAL_PX * local[:, :2] / local[:, 2:] + [159.5, 119.5]


def write_stereo(folder: Path) -> Path:
    text = 'kind = "markers-stereo"\nname = "two eyes"\n[gel]\nthickness_mm = 3.0\nE_MPa = 0.25\nnu = 0.48\n'
    for name, (turn, place) in zip(("camera", "second_camera"), CAMERAS, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, place
        text += f"[{name}]\nimage_px = [320, 240]\nfocal_px = [{FOCAL_PX}, {FOCAL_PX}]\n"
        text += "centre_px = [159.5, 119.5]\n"
        text += f"gel_from_camera = {pose.tolist()}\n"
    folder.mkdir(parents=True)
    (folder / "sensor.toml").write_text(text + "[markers]\nrows = 7\ncolumns = 9\npitch_mm = [1.8, 1.8]\n")
    (folder / "grasp.toml").write_text(PRESS)
    write_log(folder, STEREO_FRAMES)
    for camera, place in enumerate(("tip", "tip-b")):
        frames = (drawn(seen(camera, press(t)), noise=1.0, seed=2 * t + camera) for t in range(STEREO_FRAMES))
        write_camera(folder / place, drawn(seen(camera, REST), noise=1.0, seed=50 + camera), frames)
    return folder


def test_a_dent_is_seen_to_micrometres_across_and_in_depth(tmp_path: Path) -> None:
    converted = recording_of(read_raw_grasp(write_stereo(tmp_path / "g")))
    pad = converted.recording.pads[0]
    order = np.linalg.norm(REST[:, None] - pad.rest_mm[None], axis=2).argmin(axis=0)
    error = pad.displacement_mm - np.stack([press(t) - REST for t in range(STEREO_FRAMES)])[:, order]
    assert len(set(order.tolist())) == 63
    assert np.sqrt((error[..., :2] ** 2).mean()) < 0.005
    assert np.sqrt((error[..., 2] ** 2).mean()) < 0.02
    assert converted.recording.pads[0].pose[-1, 2, 3] == pytest.approx(-0.4)


def test_a_second_camera_that_lacks_frames_is_refused(tmp_path: Path) -> None:
    folder = write_stereo(tmp_path / "g")
    (folder / "tip-b/frame_000002.png").unlink()
    with pytest.raises(TactileFailure, match=r"tip-b: found 4 frames, expected the numbers of tip \(5\)"):
        read_raw_grasp(folder)


def test_the_second_camera_may_be_a_video_with_its_reference_in_the_folder_of_its_name(
    tmp_path: Path,
) -> None:
    folder = write_stereo(tmp_path / "g")
    video = cv2.VideoWriter(str(folder / "tip-b.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 240))
    for picture in sorted((folder / "tip-b").glob("frame_*.png")):
        video.write(cv2.imread(str(picture)))
        picture.unlink()
    video.release()
    with (folder / "grasp.toml").open("a") as file:
        file.write('second_frames = "tip-b.avi"\n')
    assert len(read_raw_grasp(folder).pads[0].second.pictures.numbers) == STEREO_FRAMES
    (folder / "tip-b/reference.png").unlink()
    with pytest.raises(TactileFailure, match=r"tip-b/reference\.png: found no such file"):
        read_raw_grasp(folder)


def test_the_sensor_at_the_top_is_that_of_every_pad_that_names_none(tmp_path: Path) -> None:
    folder = write_stereo(tmp_path / "g")
    text = (folder / "grasp.toml").read_text().replace('sensor = "sensor.toml"\n', "")
    (folder / "grasp.toml").write_text('sensor = "sensor.toml"\n' + text)
    assert read_raw_grasp(folder).pads[0].sensor.name == "two eyes"
