"""How large a picture is, told from its header before anything is decoded."""

import struct

_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Start-of-frame markers (ITU-T T.81, table B.1): the frame header holds height and width."""


def picture_px(data: bytes) -> tuple[int, int] | None:
    """Width and height of a JPEG or a PNG in pixels; None for what is neither, or has a broken header."""
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            width, height = struct.unpack(">II", data[16:24])
            return int(width), int(height)
        return _jpeg_px(data) if data[:3] == b"\xff\xd8\xff" else None
    except (struct.error, IndexError):
        return None


def _jpeg_px(data: bytes) -> tuple[int, int] | None:
    place = 2
    while place < len(data):
        if data[place] != 0xFF:
            return None
        marker = data[place + 1]
        if marker == 0xFF:  # fill bytes before a marker
            place += 1
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack(">HH", data[place + 5 : place + 9])
            return int(width), int(height)
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:  # no length follows
            place += 2
        elif marker in (0xD9, 0xDA):  # the end, or the scan, before any frame
            return None
        else:
            (length,) = struct.unpack(">H", data[place + 2 : place + 4])
            place += 2 + max(length, 2)
    return None
