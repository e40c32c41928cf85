"""A grasp in its raw form: the frames of each pad, and the machine's log.

The folder contains grasp.toml, log.csv and, for each pad, a folder of pictures or a video (docs/formats.md,
"A raw grasp"). A pad moves along its z by half of the aperture's change (a press: its tip by all of the
travel).
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.files.plain_file import named_in_utf8, not_plain
from tactile.markers.gaps import at_times
from tactile.readers.grasp_log import GraspLog, increasing, read_columns, read_log
from tactile.readers.pictures import PICTURES, VIDEOS, Pictures, pictures_in, read_picture, unusable
from tactile.readers.recording import PADS_OF_LOADING, Loading, Recording, Support
from tactile.readers.reference_source import FOLDERS_ABOVE, named_reference, read_reference, reference_path
from tactile.readers.sensor_file import read_sensor
from tactile.readers.toml_table import Table, read_table
from tactile.sensors import Sensor
from tactile.tactile_failure import TactileFailure, TactileProblem

PAD_KEYS = {
    "sensor", "pose", "frames", "second_frames", "reference", "reference_frames", "serial", "time_offset_s",
    "plain",
}  # fmt: skip
FRAME_TIMES = ("frame", "time_s")
"""Columns of a pad's times.csv."""
TOP_KEYS = {"fruit_id", "category", "loading", "support", "sensor", "pose_aperture_mm", "pads"}


@dataclass(frozen=True, kw_only=True)
class RawCamera:
    """One camera's picture of the untouched gel, and its frames.

    `reference_from`: the file or frames from which the picture comes.
    """

    reference: UInt8[np.ndarray, "h w 3"]
    pictures: Pictures
    reference_from: str = "reference"


@dataclass(frozen=True, kw_only=True)
class RawPad:
    """One pad's frames; `time_s` (on the log's clock) and `pose` have one value per frame. `described_in`:
    the file with its sensor's description.
    """

    name: str
    sensor: Sensor
    view: RawCamera
    second: RawCamera | None
    time_s: Float[np.ndarray, " t"]
    pose: Float[np.ndarray, "t 4 4"]
    described_in: str = "the sensor's description"


@dataclass(frozen=True, kw_only=True)
class PlainJaw:
    """A rigid jaw without a gel, and its poses in the first pad's frames."""

    name: str
    pose: Float[np.ndarray, "t 4 4"]


@dataclass(frozen=True, kw_only=True)
class RawGrasp:
    """A grasp before any frame is analysed. `recording` has the first pad's times, but no pads yet."""

    source: str
    recording: Recording
    pads: tuple[RawPad, ...]
    plain_jaw: PlainJaw | None = None


def read_raw_grasp(folder: Path, *, sensor: Path | None = None) -> RawGrasp:
    """The raw grasp in `folder`; `sensor`: a description for every pad, in place of those that the grasp
    names.

    Raises TactileFailure that names the file and the field: unreadable-frames, unreadable-sensor, or
    wrong-sensor if a pad's serial or picture differs from its description.
    """
    if not named_in_utf8(folder):
        raise unusable(folder.name, "a name that is not UTF-8", "letters and digits: rename the folder")
    _require_description(folder)
    top = read_table(folder / "grasp.toml", TactileProblem.UNREADABLE_FRAMES, what="a grasp's description")
    top.refuse_unknown(TOP_KEYS)
    loading = cast(Loading, top.choice("loading", tuple(PADS_OF_LOADING)))
    support = "free" if loading == "grasp" else "base"
    log = read_log(folder / "log.csv")
    at_mm = top.number("pose_aperture_mm", needed=True, above=-np.inf) or 0.0
    pads_table = top.table("pads", needed=True)
    names = PADS_OF_LOADING[loading]
    pads_table.refuse_unknown(names)
    shared = _sensor_path(folder, top) if sensor is None and "sensor" in top.values else None
    plain = [name for name in names if _is_plain(pads_table.table(name, needed=False))]
    if len(plain) == len(names):
        raise pads_table.refusal("plain", "true of every jaw", "one jaw with a gel at least")
    pads = tuple(
        _pad(
            folder, name, table, log, loading, at_mm, sensor or (None if "sensor" in table.values else shared)
        )
        for name in names
        if name not in plain
        for table in [pads_table.table(name, needed=True)]
    )
    _refuse_swapped(folder, pads_table, pads)
    when = pads[0].time_s
    wrench = log.wrench_N
    recording = Recording(
        fruit_id=top.text("fruit_id"),
        category=top.text("category"),
        loading=loading,
        support=cast(
            Support, top.choice("support", ("free", "base")) if "support" in top.values else support
        ),
        sensor=pads[0].sensor.name,
        time_s=when,
        aperture_mm=np.interp(when, log.time_s, log.aperture_mm),
        wrench_N=None if wrench is None else at_times(when, log.time_s, wrench),
        pads=(),
    )
    jaw = _plain_jaw(plain[0], pads_table, log, when, at_mm) if plain else None
    return RawGrasp(source=folder.name, recording=recording, pads=pads, plain_jaw=jaw)


def _pad(
    folder: Path, name: str, table: Table, log: GraspLog, loading: Loading, at_mm: float, sensor: Path | None
) -> RawPad:
    """One pad of a raw grasp: its sensor, pictures and poses. Raises TactileFailure if they do not match."""
    table.refuse_unknown(PAD_KEYS)
    description = sensor or _sensor_path(folder, table)
    described = read_sensor(description)
    pictures = pictures_in(_place(folder, name, table.file_name("frames", default="")))
    untouched = read_reference(folder, name, table, pictures)
    first = untouched.picture
    if described.camera is not None and first.shape[1::-1] != described.camera.image_px:
        width, height = described.camera.image_px
        raise TactileProblem.WRONG_SENSOR.failure(
            f"{folder.name}, pad {name}, {untouched.source}: "
            f"found {first.shape[1]} x {first.shape[0]} pixels, expected {width} x {height} as "
            f"{description.name} says; is it this sensor's description? Resized frames need a description "
            "from a picture of their own size (drupe sensor).",
        )
    second = None
    if described.kind == "markers-stereo":
        other = folder / table.file_name("second_frames", default=f"{name}-b")
        adjacent = other.with_suffix("") if other.suffix.lower() in VIDEOS else other
        other_gel = reference_path(adjacent)
        if not other_gel.is_file():
            raise unusable(
                f"{adjacent.name}/{other_gel.name}", "no such file", "the second camera's untouched gel"
            )
        second = RawCamera(reference=read_picture(other_gel), pictures=pictures_in(other))
        if second.pictures.numbers != pictures.numbers:
            fault = f"{len(second.pictures.numbers)} frames"
            raise unusable(other.name, fault, f"the numbers of {pictures.source} ({len(pictures.numbers)})")
    time_s, aperture_mm = _times(folder, name, table, pictures, log)
    poses = _poses(table, aperture_mm - at_mm, loading)
    return RawPad(
        name=name,
        sensor=described,
        view=RawCamera(
            reference=first,
            pictures=pictures,
            reference_from=untouched.source,
        ),
        second=second,
        time_s=time_s,
        pose=poses,
        described_in=description.name,
    )


def _poses(table: Table, opened_mm: Float[np.ndarray, " t"], loading: Loading) -> Float[np.ndarray, "t 4 4"]:
    """The pad's pose in each frame: it moves along its own z with the aperture."""
    pose = table.pose("pose")
    poses = np.broadcast_to(pose, (len(opened_mm), 4, 4)).copy()
    share = -0.5 if loading == "grasp" else 1.0
    poses[:, :3, 3] += (share * opened_mm)[:, None] * pose[:3, 2]
    return poses


def _is_plain(table: Table) -> bool:
    """Whether grasp.toml states that the jaw has no gel."""
    said = table.values.get("plain", False)
    if not isinstance(said, bool):
        raise table.refusal("plain", repr(said)[:40], "true for a rigid jaw without a gel, or nothing")
    return said


def _plain_jaw(
    name: str, pads: Table, log: GraspLog, when: Float[np.ndarray, " t"], at_mm: float
) -> PlainJaw:
    table = pads.table(name, needed=True)
    table.refuse_unknown({"plain", "pose"})
    aperture = np.interp(when, log.time_s, log.aperture_mm)
    return PlainJaw(name=name, pose=_poses(table, aperture - at_mm, "grasp"))


def _sensor_path(folder: Path, table: Table) -> Path:
    name = table.file_name("sensor")
    path = _nearest(folder, name)
    if path is None:
        raise table.refusal(
            "sensor", f"no file {name} in {folder.name} or above it", "a sensor's description"
        )
    return path


def _nearest(folder: Path, name: str) -> Path | None:
    """The file of this name beside grasp.toml, or in the nearest of FOLDERS_ABOVE folders above."""
    places = [place / name for place in (folder, *folder.resolve().parents[:FOLDERS_ABOVE])]
    return next((place for place in places if not not_plain(place)), None)


def files_of(folder: Path) -> tuple[Path, ...]:
    """Every file of the raw grasp: those in its folder, and those that grasp.toml names (descriptions of
    sensors, frames, pictures of the untouched gel).

    If grasp.toml is unreadable or names missing files, the list has all others.
    """
    held = {path for path in folder.rglob("*") if not not_plain(path)}
    try:
        top = read_table(
            folder / "grasp.toml", TactileProblem.UNREADABLE_FRAMES, what="a grasp's description"
        )
    except TactileFailure:
        return tuple(sorted(held))
    pads = top.values.get("pads")
    known = [(name, pads.get(name)) for name in ("left", "right", "tip")] if isinstance(pads, dict) else []
    for name, values in [("", top.values), *known]:
        if isinstance(values, dict):
            with suppress(TactileFailure):
                held.update(_named(folder, name, Table(top.path, top.problem, values)))
    return tuple(sorted(held))


def _named(folder: Path, name: str, table: Table) -> Iterator[Path]:
    """Files that one table of grasp.toml names: the grasp's own table (empty name), or a pad's."""
    sensor = _nearest(folder, table.file_name("sensor")) if "sensor" in table.values else None
    if sensor is not None:
        yield sensor
    if not name:
        return
    other = folder / table.file_name("second_frames", default=f"{name}-b")
    places = (folder / name, _place(folder, name, table.file_name("frames", default="")), other)
    for place in (*places, other.with_suffix("")):
        yield from _pictures(place)
    said = table.file_name("reference", default=f"{name}/reference.png")
    yield from _pictures(named_reference(folder, table, said))


def _pictures(place: Path) -> Iterator[Path]:
    """The file itself, or the frames in a folder and their times."""
    held = place.iterdir() if place.is_dir() and os.access(place, os.R_OK) else ()
    pictures = (p for p in held if p.suffix.lower() in PICTURES or p.name == "times.csv")
    yield from (path for path in (place, *pictures) if not not_plain(path))


def _place(folder: Path, name: str, said: str) -> Path:
    if said:
        return folder / said
    videos = [folder / f"{name}{suffix}" for suffix in VIDEOS]
    pictured = folder / name
    if pictured.is_dir() and any(path.stem.startswith("frame_") for path in pictured.iterdir()):
        return pictured
    return next((video for video in videos if video.is_file()), pictured)


def _times(
    folder: Path, name: str, table: Table, pictures: Pictures, log: GraspLog
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Each frame's time on the log's clock, and the aperture at that time."""
    table_said = f"{name}/times.csv"
    if (folder / table_said).is_file():
        columns = read_columns(folder / table_said, wanted=FRAME_TIMES, source=table_said)
        increasing(table_said, columns["time_s"])
        stamps = dict(zip(columns["frame"].astype(int).tolist(), columns["time_s"].tolist(), strict=True))
    elif log.frame is not None:
        stamps = dict(zip(log.frame.tolist(), log.time_s.tolist(), strict=True))
        table_said = "log.csv"
    else:
        if len(log.time_s) != len(pictures.numbers):
            expected = f"{len(log.time_s)} as log.csv has rows; or say in a column `frame` which is which"
            raise unusable(pictures.source, f"{len(pictures.numbers)} frames", expected)
        stamps = dict(zip(pictures.numbers, log.time_s.tolist(), strict=True))
        table_said = "log.csv"
    missing = [number for number in pictures.numbers if number not in stamps]
    if missing:
        fault = f"no time for frame {missing[0]} ({len(missing)} such)"
        raise unusable(table_said, fault, f"a row for each frame of {pictures.source}")
    offset = table.numbers("time_offset_s", (), needed=False)
    time_s = np.array([stamps[n] for n in pictures.numbers]) - (0.0 if offset is None else float(offset))
    outside = (time_s < log.time_s[0] - 1e-9) | (time_s > log.time_s[-1] + 1e-9)
    if outside.any():
        fault = f"frames from {time_s[0]:g} to {time_s[-1]:g} s"
        expected = f"times within the log's, {log.time_s[0]:g} to {log.time_s[-1]:g} s; set time_offset_s"
        raise unusable(pictures.source, fault, expected)
    return time_s, np.interp(time_s, log.time_s, log.aperture_mm)


def _require_description(folder: Path) -> None:
    """Raises TactileFailure, with the folder and its contents, if it has no grasp.toml."""
    names = [path.name for path in folder.iterdir() if not path.name.startswith((".", "@"))]
    if "grasp.toml" in names:
        return
    recordings = [name for name in names if name.lower().endswith((".h5", ".hdf5", ".mat"))]
    fault = "no grasp.toml" if names else "an empty folder"
    expected = "grasp.toml, log.csv and the frames of a raw grasp; fill the folder, or move it away"
    if recordings:
        fault += f", but {recordings[0]}" + (f" and {len(recordings) - 1} more" if recordings[1:] else "")
        expected = "recordings beside each other in grasps/; move them up"
    raise unusable(folder.name, fault, expected)


def _refuse_swapped(folder: Path, table: Table, pads: tuple[RawPad, ...]) -> None:
    """Raises TactileFailure (wrong-sensor) if a pad's serial number differs from its sensor's."""
    said = {pad.name: table.table(pad.name, needed=True).text("serial", default="") for pad in pads}
    for pad in pads:
        serial = said[pad.name]
        if serial and pad.sensor.serial and serial != pad.sensor.serial:
            other = [p.name for p in pads if p is not pad and p.sensor.serial == serial]
            advice = (
                f"; it is the {other[0]} pad's: the pads are swapped"
                if other
                else "; give that sensor's file"
            )
            raise TactileProblem.WRONG_SENSOR.failure(
                f"{folder.name}/grasp.toml: pads.{pad.name}.serial: found {serial!r}, expected "
                f"{pad.sensor.serial!r} as its sensor's description says{advice}.",
            )
