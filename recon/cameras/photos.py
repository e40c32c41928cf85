"""Reads the photos of one fruit: upright BGR images of a workable size, and the focal length in EXIF."""

import struct
import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pi_heif
from jaxtyping import Float, Int
from PIL import Image, ImageOps, UnidentifiedImageError

from pipeline.files.plain_file import NotReadable, named_in_utf8, printable, read_bytes
from recon.picture_values import Picture
from recon.recon_failure import ReconFailure, ReconProblem

SUFFIXES = (".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".heic", ".heif", ".hif")
"""Suffixes in any case. WebP, TIFF, AVIF and raw pictures are not read (see unused_photos.py)."""
FEWEST_PHOTOS = 3
"""Least number of photos: two may agree in an error, which a third one shows."""
MOST_PHOTOS = 500
"""500 photos of 1600 x 1200 px take 2.9 GB; 24 are advised, a turntable takes 72."""
MOST_BYTES = 200_000_000
"""Largest file of a photo: about a byte for each of MOST_PIXELS. Set by hand."""
MOST_PIXELS, MOST_WHOLE_PIXELS = 210_000_000, 60_000_000
"""The largest sensors of phones have 200 megapixels; 60 megapixels take 180 MB once decoded. A larger JPEG is
decoded at a half, a quarter or an eighth of its sides. Other larger pictures are refused, also a progressive
JPEG, which takes the memory of its full size at any scale."""
SHORTEST_SIDE_PX, MOST_LONGEST_OVER_SHORTEST = 32, 8.0
"""Shortest side, and largest ratio of sides (a panorama's), of a photo that can show a fruit."""
FULL_FRAME_WIDTH_MM = 36.0
"""Width of the film that "35 mm equivalent" focal lengths refer to."""
READ = ("JPEG", "PNG", "HEIF")
"""Pillow's names of the formats that are read. It calls a JPEG that holds a second picture MPO."""
_HEIF_BRANDS = {
    **dict.fromkeys((b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"), "HEIC"),
    **dict.fromkeys((b"avif", b"avis"), "AVIF"),
    b"crx ": "raw",
}
"""Major brands of pictures in an ISO base media file (ISO/IEC 23008-12; crx: Canon's raw pictures)."""
_FIRST_BYTES = (
    (b"\xff\xd8\xff", "JPEG"),
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"II*\0", "TIFF or raw"),
    (b"MM\0*", "TIFF or raw"),
    (b"II+\0", "TIFF"),
    (b"MM\0+", "TIFF"),
    (b"IIU\0", "raw"),
    (b"IIRO", "raw"),
    (b"IIRS", "raw"),
    (b"FUJIFILMCCD-RAW", "raw"),
    (b"GIF8", "GIF"),
    (b"\xff\x0a", "JPEG XL"),
    (b"\0\0\0\x0cJXL ", "JPEG XL"),
    (b"\0\0\0\x0cjP  ", "JPEG 2000"),
)
"""First bytes of pictures, and their kinds."""
EXIF_IFD, FOCAL_35MM = 0x8769, 0xA405
"""Tags of Exif 2.32 (CIPA DC-008): the directory of the photo, and FocalLengthIn35mmFilm in it."""
BROKEN = (OSError, SyntaxError, ValueError, EOFError, RuntimeError, MemoryError, struct.error)
"""Exceptions of Pillow's readers for files that are no whole pictures."""
pi_heif.register_heif_opener()
Image.MAX_IMAGE_PIXELS = None  # `_require_size` checks sizes, with limits of our own


@dataclass(frozen=True)
class Photo:
    """A photo: name, pixels (BGR), focal length in its pixels (EXIF), and the mat's tags once detected."""

    name: str
    image: Picture
    focal_px: float | None = None
    tags: tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 4 2"]] | None = None


def photo_paths(folder: Path) -> tuple[Path, ...]:
    """The photos of a folder: files with one of SUFFIXES (in any case), sorted by name.

    Hidden files (cameras and phones leave a ._001.jpg), folders and broken links are skipped; a folder that
    does not exist has no photos.
    """
    if not folder.is_dir():
        return ()
    visible = (p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    return tuple(sorted(p for p in visible if p.is_file()))


def read_photo(path: Path, *, longest_side_px: int = 1600) -> Photo:
    """One photo, upright by EXIF, shrunk if its longest side exceeds `longest_side_px`.

    Raises ReconFailure (unreadable-photo) that names the file if it is damaged, no picture, or of unfit size.
    """
    if not named_in_utf8(path):
        raise _unreadable(path, "has a name that is not UTF-8", "letters, digits, - and _: rename it")
    try:
        data = read_bytes(path, most_bytes=MOST_BYTES)
    except NotReadable as error:
        raise _unreadable(path, str(error)) from error
    if not data:
        raise _unreadable(path, "is empty")
    try:
        # Pillow warns of unreadable EXIF, which is not needed
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(BytesIO(data), formats=READ) as picture,
        ):
            return _photo(path, picture, longest_side_px)
    except UnidentifiedImageError as error:
        kind = picture_kind(data[:32])
        if kind not in ("", "JPEG", "PNG", "HEIC"):
            fault = f"is a picture of another format ({kind})"
            raise _unreadable(path, fault, "a JPEG, PNG or HEIC: convert it or remove it") from error
        raise _unreadable(path, "is no picture that can be decoded") from error
    except BROKEN as error:
        raise _unreadable(path, f"is damaged or was cut short ({error})") from error


def picture_kind(head: bytes) -> str:
    """Kind of a picture by the first bytes of its file (32 suffice); empty if it is none.

    >>> picture_kind(b"\\xff\\xd8\\xff\\xe0"), picture_kind(b"RIFF1234WEBP"), picture_kind(b"text")
    ('JPEG', 'WebP', '')
    """
    if head[4:8] == b"ftyp":
        return _HEIF_BRANDS.get(head[8:12], "")
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WebP"
    if head[:2] == b"BM" and head[6:10] == bytes(4):
        return "bitmap (BMP)"
    return next((kind for first, kind in _FIRST_BYTES if head.startswith(first)), "")


def _photo(path: Path, picture: Image.Image, longest_side_px: int) -> Photo:
    """The picture upright and small enough, with its focal length; raises ReconFailure, or one of BROKEN."""
    width, height = picture.size
    _require_size(path, picture)
    focal_35mm = picture.getexif().get_ifd(EXIF_IFD).get(FOCAL_35MM)
    if width * height > MOST_WHOLE_PIXELS:
        picture.draft("RGB", (longest_side_px, longest_side_px))
    upright = ImageOps.exif_transpose(picture)
    pixels = np.asarray(upright if upright.mode.startswith("I") else upright.convert("RGB"))
    if pixels.ndim == 2:  # grey of 16 bits
        pixels = np.repeat((pixels >> 8).astype(np.uint8)[..., None], 3, axis=2)
    longest_px = max(pixels.shape)
    if longest_px > longest_side_px:
        rows, columns = (round(side * longest_side_px / longest_px) for side in pixels.shape[:2])
        pixels = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
    focal_px = focal_35mm / FULL_FRAME_WIDTH_MM * max(pixels.shape) if focal_35mm else None
    return Photo(path.name, np.ascontiguousarray(pixels[..., ::-1]), focal_px)


def _require_size(path: Path, picture: Image.Image) -> None:
    """Refuse, before decoding, a picture that would not fit into memory or cannot show a fruit."""
    width, height = picture.size
    progressive = bool(picture.info.get("progressive"))
    reduced = picture.format in ("JPEG", "MPO") and not progressive
    most_pixels = MOST_PIXELS if reduced else MOST_WHOLE_PIXELS
    if width * height > most_pixels:
        fault = f"has {width} x {height} pixels" + (" in a progressive JPEG" if progressive else "")
        other = "save it as a baseline JPEG, " if progressive else ""
        most = f"at most {most_pixels / 1e6:g} million pixels: {other}make it smaller or remove it"
        raise _unreadable(path, fault, most)
    few = min(width, height) < SHORTEST_SIDE_PX
    if few or max(width, height) > MOST_LONGEST_OVER_SHORTEST * min(width, height):
        fault = f"has {width} x {height} pixels, {'too few to show a fruit' if few else 'a strip'}"
        raise _unreadable(path, fault, "a photo: take it again or remove it")


def read_photos(folder: Path) -> tuple[Photo, ...]:
    """All photos of a folder, by name.

    Raises ReconFailure: too-few-views (see `require_enough`), unreadable-photo for the first unreadable file.
    """
    paths = photo_paths(folder)
    require_enough(len(paths), where=str(folder))
    return tuple(read_photo(path) for path in paths)


def require_enough(count: int, *, where: str) -> None:
    """Raise ReconFailure (too-few-views) for fewer than FEWEST_PHOTOS, or more than MOST_PHOTOS."""
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


def _unreadable(
    path: Path, fault: str, expected: str = "a whole JPEG, PNG or HEIC: copy it again or remove it"
) -> ReconFailure:
    name, folder = printable(path.name), printable(str(path.parent))
    said = f"The photo {name} in {folder} {fault}; expected {expected}."
    return ReconProblem.UNREADABLE_PHOTO.failure(said)
