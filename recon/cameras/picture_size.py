"""What a picture's header tells before decoding: its kind, its size, and if it can be decoded by rows."""

import struct
from collections.abc import Iterator

_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Start-of-frame markers (ITU-T T.81, table B.1): the frame header holds height and width."""
_SEQUENTIAL = {0xC0, 0xC1}
"""The frames whose scans can be decoded row by row (the same table); of others every coefficient is kept."""
_SCAN = 0xDA
"""JPEG's marker "start of scan" (ITU-T T.81): the picture's data follow."""


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


def picture_kind(head: bytes) -> str:
    """What kind of picture a file is by its first bytes, of which 32 do; empty where it is none.

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


def picture_px(data: bytes) -> tuple[int, int] | None:
    """Width and height of a JPEG or a PNG in pixels; None for what is neither, or has a broken header."""
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            width, height = struct.unpack(">II", data[16:24])
            return int(width), int(height)
        frame = next((place for marker, place in _segments(data) if marker in _JPEG_FRAMES), None)
        if frame is None:
            return None
        height, width = struct.unpack(">HH", data[frame + 5 : frame + 9])
        return int(width), int(height)
    except struct.error:
        return None


def first_scan(jpeg: bytes) -> int:
    """Where a JPEG's picture begins, behind headers that may hold a small one; its length if it never does.

    The first end marker behind it is the picture's (ITU-T T.81, B.1.1.5: in coded data 0xFF stands before 0
    or a restart marker alone); phones put a film after it.
    """
    return next((place for marker, place in _segments(jpeg) if marker == _SCAN), len(jpeg))


def in_one_pass(jpeg: bytes) -> bool:
    """Whether a JPEG can be decoded row by row: sequential, all its colours in the first scan.

    A decoder must hold all coefficients of any other (progressive ones, or a scan for each colour), at full
    size even where only a share of its sides is wanted.
    """
    colours = 0
    for marker, place in _segments(jpeg):
        if marker in _JPEG_FRAMES:
            if marker not in _SEQUENTIAL:
                return False
            colours = jpeg[place + 9] if place + 9 < len(jpeg) else 0
        elif marker == _SCAN:
            return place + 4 < len(jpeg) and 0 < colours == jpeg[place + 4]
    return False


def _segments(jpeg: bytes) -> Iterator[tuple[int, int]]:
    """Each marker of a JPEG's headers and its place, up to the first scan.

    Found as libjpeg does (jdmarker.c, next_marker): bytes between segments are skipped, lest another frame
    header be read than the decoder uses.
    """
    place = 2 if jpeg[:3] == b"\xff\xd8\xff" else len(jpeg)
    while 0 <= (place := jpeg.find(b"\xff", place)) < len(jpeg) - 1:
        marker = jpeg[place + 1]
        if marker in (0x00, 0xFF):  # no marker; a fill byte before one
            place += 1
            continue
        yield marker, place
        if marker in (0xD9, _SCAN):
            return
        alone = marker == 0x01 or 0xD0 <= marker <= 0xD8  # no length follows
        place += 2 if alone else 2 + max(int.from_bytes(jpeg[place + 2 : place + 4], "big"), 2)
