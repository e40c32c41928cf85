"""Reads the photos of one fruit: upright BGR images of a workable size, and the focal length in EXIF."""

import struct
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pi_heif
from jaxtyping import Float, Int, UInt8

from pipeline.files.plain_file import NotReadable, named_in_utf8, printable, read_bytes
from recon.cameras.picture_size import first_scan, in_one_pass, picture_kind, picture_px
from recon.recon_failure import ReconFailure, ReconProblem

SUFFIXES = (".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".heic", ".heif", ".hif")
"""In any case. WebP, TIFF, AVIF and raw pictures are not read (unused_photos.py names such files)."""
FEWEST_PHOTOS = 3
"""Of any reconstruction: two that err agree with each other, a third one tells."""
MOST_PHOTOS = 500
"""500 photos of 1600 x 1200 px take 2.9 GB; 24 are advised, a turntable takes 72."""
MOST_BYTES = 200_000_000
"""Of one photo's file: about a byte for each of MOST_PIXELS. Set by hand."""
MOST_PIXELS, MOST_WHOLE_PIXELS = 210_000_000, 60_000_000
"""The largest sensors of phones have 200 megapixels. 60 megapixels take 180 MB once decoded; a JPEG that is
larger is decoded at a half, a quarter or an eighth of its sides, anything else that is larger is refused: a
progressive JPEG takes its memory at full size whatever is wanted of it (203 megapixels of one, 4:2:0, 690 MiB
at an eighth of its sides, of a baseline one 130; at 4:4:4 twice that)."""
SHORTEST_SIDE_PX, MOST_LONGEST_OVER_SHORTEST = 32, 8.0
"""Below, and beyond a panorama's 8 to 1, no fruit can be seen in it."""
FULL_FRAME_WIDTH_MM = 36.0
"""Width of the film that "35 mm equivalent" focal lengths refer to."""


@dataclass(frozen=True)
class Photo:
    """A picture: name, pixels (BGR), focal length in its pixels (EXIF), and, once sought, the mat's tags."""

    name: str
    image: UInt8[np.ndarray, "h w 3"]
    focal_px: float | None = None
    tags: tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 4 2"]] | None = None


def photo_paths(folder: Path) -> tuple[Path, ...]:
    """What counts as a photo: a folder's files with one of SUFFIXES (in any case), sorted by name.

    Hidden files (cameras and phones leave a ._001.jpg), folders and links to nothing are no photos; a folder
    that does not exist holds none.
    """
    if not folder.is_dir():
        return ()
    visible = (p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    return tuple(sorted(p for p in visible if p.is_file()))


def read_photo(path: Path, *, longest_side_px: int = 1600) -> Photo:
    """One photo, turned upright as EXIF says, shrunk to `longest_side_px` where it is larger.

    Raises ReconFailure (unreadable-photo) that names the file when it is empty, cut short or no picture.
    """
    if not named_in_utf8(path):
        raise _unreadable(path, "has a name that is not UTF-8", "letters, digits, - and _: rename it")
    try:
        data = read_bytes(path, most_bytes=MOST_BYTES)
    except NotReadable as error:
        raise _unreadable(path, str(error)) from error
    if not data:
        raise _unreadable(path, "is empty")
    if data[:2] == b"\xff\xd8" and data.find(b"\xff\xd9", first_scan(data)) < 0:
        raise _unreadable(path, "is a JPEG that was cut short (its end marker is missing)")
    if data[:4] == b"\x89PNG" and b"IEND" not in data[-4096:]:
        raise _unreadable(path, "is a PNG that was cut short (its end mark is missing)")
    kind = picture_kind(data[:32])
    if kind not in ("", "JPEG", "PNG", "HEIC"):
        raise _unreadable(
            path, f"is a picture of another format ({kind})", "a JPEG, PNG or HEIC: convert it or remove it"
        )
    if data[4:8] == b"ftyp":
        image, exif = _heif(data, path)
    else:
        image, exif = _decoded(data, path, longest_side_px), data
    height, width = image.shape[:2]
    focal_px = exif_focal_px(exif, longest_px=max(height, width))
    shrink = longest_side_px / max(height, width)
    if shrink < 1:
        size = (round(width * shrink), round(height * shrink))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        focal_px = None if focal_px is None else focal_px * shrink
    return Photo(path.name, np.asarray(image, np.uint8), focal_px)


def _require_size(
    path: Path, width: int, height: int, most_pixels: int, *, progressive: bool = False
) -> None:
    """Refuse, before it is decoded, what would not fit into memory or cannot show a fruit."""
    if width * height > most_pixels:
        fault = f"has {width} x {height} pixels" + (" in a progressive JPEG" if progressive else "")
        other = "save it as a baseline JPEG, " if progressive else ""
        most = f"at most {most_pixels / 1e6:g} million pixels: {other}make it smaller or remove it"
        raise _unreadable(path, fault, most)
    few = min(width, height) < SHORTEST_SIDE_PX
    if few or max(width, height) > MOST_LONGEST_OVER_SHORTEST * min(width, height):
        fault = f"has {width} x {height} pixels, {'too few to show a fruit' if few else 'a strip'}"
        raise _unreadable(path, fault, "a photo: take it again or remove it")


def _require_promised(path: Path, size: tuple[int, int], promised: tuple[int, int]) -> None:
    """Refuse a picture that is decoded to another size than its header says, turned or not."""
    if sorted(size) != sorted(promised):
        said = f"its header says {promised[0]} x {promised[1]} pixels, it holds {size[0]} x {size[1]}"
        raise _unreadable(path, f"is damaged ({said})")


def _decoded(data: bytes, path: Path, longest_side_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """The picture, reduced while it is decoded where it is too large; raises ReconFailure."""
    size = picture_px(data)
    if size is None:
        raise _unreadable(path, "is no picture that can be decoded")
    jpeg, way = data[:2] == b"\xff\xd8", cv2.IMREAD_COLOR
    progressive = jpeg and not in_one_pass(data)
    most = MOST_PIXELS if jpeg and not progressive else MOST_WHOLE_PIXELS
    _require_size(path, *size, most, progressive=progressive)
    part = 1
    if size[0] * size[1] > MOST_WHOLE_PIXELS:
        share = max(size) / longest_side_px
        part, way = next((reduced for reduced in _REDUCED if share >= reduced[0]), (part, way))
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), way)
    except cv2.error as error:
        raise _unreadable(path, "cannot be decoded") from error
    if image is None:
        raise _unreadable(path, "is no picture that can be decoded")
    height, width = image.shape[:2]
    _require_promised(path, (width, height), (-(-size[0] // part), -(-size[1] // part)))
    return np.asarray(image, np.uint8)


def _heif(data: bytes, path: Path) -> tuple[UInt8[np.ndarray, "h w 3"], bytes]:
    """A phone's HEIC (ISO/IEC 23008-12), turned upright by its own rotation property, and its EXIF block.

    The pixels are copied at once: their memory is freed with `picture`, whatever arrays still look at it.
    """
    try:
        picture = pi_heif.open_heif(data, convert_hdr_to_8bit=True, bgr_mode=True)
        promised = picture.size
        _require_size(path, promised[0], promised[1], MOST_WHOLE_PIXELS)
        pixels = np.array(picture)
        exif = bytes(picture.info.get("exif") or b"")
    except (ValueError, RuntimeError, SyntaxError, EOFError, MemoryError, OSError) as error:
        raise _unreadable(path, "is a HEIC that cannot be decoded") from error
    height, width = pixels.shape[:2]
    _require_promised(path, (width, height), promised)
    if pixels.dtype != np.uint8:  # grey of 10 or 12 bits, which the library spreads over 16
        pixels = (pixels >> 8).astype(np.uint8)
    grey = pixels.ndim == 2 or pixels.shape[2] < 3
    colours = np.repeat(pixels.reshape(height, width, -1)[..., :1], 3, axis=2) if grey else pixels[..., :3]
    return np.ascontiguousarray(colours), exif


def read_photos(folder: Path) -> tuple[Photo, ...]:
    """All photos of a folder, by name.

    Raises ReconFailure: too-few-views under three photos, unreadable-photo for the first file that is none.
    """
    paths = photo_paths(folder)
    require_enough(len(paths), where=str(folder))
    return tuple(read_photo(path) for path in paths)


_REDUCED = ((8, cv2.IMREAD_REDUCED_COLOR_8), (4, cv2.IMREAD_REDUCED_COLOR_4), (2, cv2.IMREAD_REDUCED_COLOR_2))
"""Parts of its sides to which OpenCV decodes a JPEG, the strongest first."""


def require_enough(count: int, *, where: str) -> None:
    """Refuse fewer than three photos, and more than memory holds."""
    if count > MOST_PHOTOS:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"{where} holds {count} photos; at most {MOST_PHOTOS} are read: keep some 24 to 72, evenly "
            "around the fruit."
        )
    if count < FEWEST_PHOTOS:
        raise ReconProblem.TOO_FEW_VIEWS.failure(
            f"{where} holds {count} photo{'' if count == 1 else 's'}; a shape needs at least "
            f"{FEWEST_PHOTOS}, "
            "and 24 all around the fruit are advised: take more photos."
        )


def exif_focal_px(data: bytes, *, longest_px: int) -> float | None:
    """Focal length (px) from EXIF's FocalLengthIn35mmFilm of a JPEG or a HEIC's EXIF block, or None.

    f_px = f_35 / 36 mm * longest side. Tag numbers: Exif 2.32 (CIPA DC-008), 0x8769 and 0xA405.
    """
    start = data.find(b"Exif\x00\x00", 0, 65536)
    if start < 0:
        return None
    tiff = data[start + 6 : start + 6 + 65536]
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return None
    try:
        (first,) = struct.unpack_from(order + "I", tiff, 4)
        exif = _tag(tiff, order, first, 0x8769)
        focal_35mm = None if exif is None else _tag(tiff, order, exif, 0xA405)
    except struct.error:
        return None
    return focal_35mm / FULL_FRAME_WIDTH_MM * longest_px if focal_35mm else None


def _tag(tiff: bytes, order: str, directory: int, wanted: int) -> int | None:
    (count,) = struct.unpack_from(order + "H", tiff, directory)
    for entry in range(directory + 2, directory + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", tiff, entry)
        if tag == wanted:
            value: int = struct.unpack_from(order + ("H" if kind == 3 else "I"), tiff, entry + 8)[0]
            return value
    return None


def _unreadable(
    path: Path, fault: str, expected: str = "a whole JPEG, PNG or HEIC: copy it again or remove it"
) -> ReconFailure:
    where = f"{printable(path.name)} in {printable(str(path.parent))}"
    return ReconProblem.UNREADABLE_PHOTO.failure(f"{where} {fault}; expected {expected}.")
