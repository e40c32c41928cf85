"""A raw grasp becomes a recording, and whatever is wrong with it is said by file and field."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_gel import drawn, grid
from raw_folder import CENTRE, DEPTH_MM, FRAMES, PX_PER_MM, replaced, shear, write_picture, write_raw
from scipy.spatial import cKDTree

from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import Converted, GelPad
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
    with pytest.raises(TactileFailure) as caught:
        recording_of(read_raw_grasp(raw))
    assert says in str(caught.value)
    assert caught.value.problem is problem


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
    with pytest.raises(TactileFailure, match=r"left\.avi: found .*copy it again") as caught:
        recording_of(read_raw_grasp(raw))
    assert caught.value.problem is P.UNREADABLE_FRAMES


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
