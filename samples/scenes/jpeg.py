"""JPEG files as cameras write them: stored turned, with the EXIF orientation that undoes it."""

import struct
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

# EXIF orientation: the turn from the picture as seen to the picture as stored (np.rot90 counts left turns)
_LEFT_TURNS = {1: 0, 3: 2, 6: 1, 8: 3}


def write_jpeg(path: Path, image: UInt8[np.ndarray, "h w 3"], *, quality: int, orientation: int = 1) -> None:
    """Write a BGR picture; with an orientation other than 1, stored turned and tagged (EXIF 2.3, tag 0x0112).

    Raises OSError when the file cannot be written.
    """
    stored = np.ascontiguousarray(np.rot90(image, _LEFT_TURNS[orientation]))
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    data = cv2.imencode(".jpg", stored, flags)[1].tobytes()
    if orientation != 1:
        entry = struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)
        tiff = b"II*\x00" + struct.pack("<IH", 8, 1) + entry + struct.pack("<I", 0)
        body = b"Exif\x00\x00" + tiff
        data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    path.write_bytes(data)
