"""Reads one camera's frames one by one from numbered pictures or a video, and checks them meanwhile."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.files.limited_memory import limited_memory
from pipeline.files.plain_file import (
    NO_LFS_FILE,
    NotReadable,
    is_lfs_pointer,
    not_plain,
    read_bytes,
    read_head,
    size,
)
from tactile.tactile_failure import TactileFailure, TactileProblem

PICTURES = (".png", ".jpg", ".jpeg")
VIDEOS = (".avi", ".mp4")
MOST_BYTES, MOST_PIXELS, MOST_FRAMES = 100_000_000, 25_000_000, 200_000
"""Most bytes of a picture, pixels of a frame, and frames. Cameras in gels have 0.3 to 5 million pixels;
200,000 frames are an hour at 55 a second."""
MOST_FRAME_MEMORY = 1_000_000_000
"""Bytes for one frame and its decoding: a frame of 25 million pixels has 75 MB."""
PICTURES_BEGIN = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")
"""First bytes of PNG and JPEG: other formats may unpack to any size, or name other files."""
MP4_BEGINS = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")
"""Types of the first box of an MP4 or QuickTime file (ISO/IEC 14496-12)."""
NUMBERED = re.compile(r"^frame_(\d+)$")
WHITE = 250
"""Grey level of 255 from which a pixel counts as white: JPEG changes a few levels."""
SATURATED = 0.1
"""Largest share of white pixels in a usable frame."""
GAP = 1.6
"""Ratio of a time step to the usual one above which frames are missing."""
EVERY = 4
"""Step between the rows and columns that are inspected: enough for a share."""


@dataclass(frozen=True)
class Pictures:
    """`frames()` starts a new pass, in RGB. `numbered`: the numbers are the recorder's, not counted here."""

    source: str
    numbers: tuple[int, ...]
    frames: Callable[[], Iterator[UInt8[np.ndarray, "h w 3"]]]
    numbered: bool = False


def unusable(source: str, fault: str, expected: str) -> TactileFailure:
    """The failure of a file of frames or numbers: what was found, and what was expected."""
    return TactileProblem.UNREADABLE_FRAMES.failure(f"{source}: found {fault}, expected {expected}.")


def absence(path: Path) -> str:
    """Why `path` is no readable file, as the object of "found"; empty if it is one."""
    wrong = not_plain(path)
    return "no such file" if wrong == "does not exist" else wrong and f"that it {wrong}"


def read_picture(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """One RGB picture; raises TactileFailure (unreadable-frames) if it is missing, damaged or too large."""
    if missing := absence(path):
        raise unusable(path.name, missing, "a .png or .jpg picture")
    named = f"{path.parent.name}/{path.name}"
    try:
        data = read_bytes(path, most_bytes=MOST_BYTES)
    except NotReadable as cause:
        raise unusable(named, f"that it {cause}", "a whole picture; copy it again") from cause
    picture = None
    if data.startswith(PICTURES_BEGIN) and not _cut_short(data):
        with suppress(cv2.error, MemoryError), limited_memory(MOST_FRAME_MEMORY):
            picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        fault = f"a damaged picture, no PNG or JPEG, or more than {size(MOST_FRAME_MEMORY)} of pixels"
        raise unusable(named, fault, "a whole one; copy it again")
    _require_few_pixels(named, *picture.shape[1::-1])
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _require_few_pixels(source: str, wide: int, high: int) -> None:
    if wide * high > MOST_PIXELS:
        raise unusable(source, f"frames of {wide} x {high} pixels", f"at most {MOST_PIXELS / 1e6:g} million")


def pictures_in(place: Path) -> Pictures:
    """The frames at `place`: a folder with frame_000000.png ..., or a video.

    Raises TactileFailure (unreadable-frames) if neither is there, a number is repeated, or the video is
    unreadable.
    """
    if place.is_dir():
        return _folder(place)
    if place.suffix.lower() in VIDEOS and place.is_file():
        return _video(place)
    expected = f"a folder with frame_000000.png ..., or a video ({', '.join(VIDEOS)})"
    raise unusable(place.name, "no such folder or video", expected)


def _folder(folder: Path) -> Pictures:
    """The numbered pictures frame_*.png or .jpg of a folder, read one by one. Raises TactileFailure."""
    paths: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        named = NUMBERED.match(path.stem)
        if named is None or path.suffix.lower() not in PICTURES:
            continue
        if len(named.group(1)) > 12:
            raise unusable(folder.name, path.name[:60], "numbers of at most 12 digits")
        number = int(named.group(1))
        if number in paths:
            raise unusable(folder.name, f"{paths[number].name} and {path.name}", "each frame once")
        paths[number] = path
    if not paths:
        raise unusable(folder.name, "no frame_*.png or .jpg", "frame_000000.png, frame_000001.png, ...")
    numbers = tuple(sorted(paths))

    def frames() -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        for number in numbers:
            yield read_picture(paths[number])

    return Pictures(folder.name, numbers, frames, numbered=True)


def _video(path: Path) -> Pictures:
    """The frames of a video, read one by one. Raises TactileFailure if it is unreadable or cut short."""
    _require_container(path)
    video = _capture(path)
    said = int(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0
    wide, high = (
        int(video.get(property_id)) for property_id in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    video.release()
    if said < 1:
        raise unusable(path.name, "a video that cannot be opened", "a whole one; copy it again")
    if said > MOST_FRAMES:
        raise unusable(path.name, f"{said} frames", f"at most {MOST_FRAMES}")
    _require_few_pixels(path.name, wide, high)

    def frames() -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        video = _capture(path)
        try:
            for k in range(said):
                with limited_memory(MOST_FRAME_MEMORY):
                    more, frame = video.read()
                if not more:
                    expected = (
                        f"{said} of {wide} x {high} pixels as its header says: it is cut short or damaged, "
                        "copy it again"
                    )
                    raise unusable(path.name, f"{k} frames", expected)
                yield np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), dtype=np.uint8)
        finally:
            video.release()

    return Pictures(path.name, tuple(range(said)), frames)


def _require_container(path: Path) -> None:
    """Raises TactileFailure unless the first bytes are those of AVI or MP4.

    FFmpeg also reads lists of files (ffconcat, HLS, SDP), and would open files that the user did not name.
    """
    try:
        begin = read_head(path, 12)
    except NotReadable as cause:
        raise unusable(path.name, f"that it {cause}", "a video") from cause
    if is_lfs_pointer(path):
        raise unusable(path.name, f"that it {NO_LFS_FILE}", "the video itself")
    avi = begin[:4] == b"RIFF" and begin[8:12] == b"AVI "
    if not avi and begin[4:8] not in MP4_BEGINS:
        raise unusable(path.name, "no video of a kind that is read", "an AVI or MP4 file, whatever its name")


def _capture(path: Path) -> cv2.VideoCapture:
    """The open video, decoded by FFmpeg in one thread, since each thread buffers frames."""
    with limited_memory(MOST_FRAME_MEMORY):
        return cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])


def _cut_short(data: bytes) -> bool:
    """Whether the end mark is missing: decoders fill missing rows with grey and report no error."""
    tail = data[-4096:].rstrip(b"\0")[-64:]  # some recorders pad the last block
    return (b"IEND" if data.startswith(PICTURES_BEGIN[0]) else b"\xff\xd9") not in tail


def checked(
    frames: Iterable[UInt8[np.ndarray, "h w 3"]], source: str, shape: tuple[int, int]
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """The same frames; raises TactileFailure for one that is over-exposed or has another size."""
    for k, frame in enumerate(frames):
        if frame.shape[:2] != shape:
            fault = f"frame {k} of {frame.shape[1]} x {frame.shape[0]} pixels"
            raise unusable(source, fault, f"{shape[1]} x {shape[0]} as the reference")
        refuse_saturated(frame, f"{source}: frame {k}")
        yield frame


def refuse_saturated(frame: UInt8[np.ndarray, "h w 3"], source: str) -> None:
    """Raises TactileFailure (gel-saturated) if over a tenth of the frame is white in every channel."""
    share = float((frame[::EVERY, ::EVERY].min(axis=2) >= WHITE).mean())
    if share > SATURATED:
        raise TactileProblem.SATURATED.failure(
            f"{source}: found {share:.0%} of the gel over-exposed, expected at most {SATURATED:.0%}; "
            "reduce the sensor's lights or exposure.",
        )


def gaps_said(
    time_s: Float[np.ndarray, " t"], source: str, *, numbers: Int[np.ndarray, " t"] | None = None
) -> list[str]:
    """A note on missing frames: by gaps in their `numbers` if they have any, otherwise by long time steps.

    Consecutive numbers show that no frame is missing, however irregular the times.
    """
    if len(time_s) < 3:
        return []
    step = np.diff(time_s)
    usual = float(np.median(step))
    long = np.flatnonzero(step > GAP * usual if numbers is None else np.diff(numbers) > 1)
    if not len(long):
        return []
    steps = step[long] / usual if numbers is None else np.diff(numbers)[long]
    return [
        (
            f"{source}: about {int(np.rint(steps).sum() - len(long))} frames are missing in {len(long)} "
            f"gaps, the first after {time_s[long[0]]:.3f} s (usual step {usual * 1e3:.1f} ms)."
        )
    ]
