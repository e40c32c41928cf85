"""Pictures as phones, cameras and attackers write them: HEIC, markers of a JPEG, names of photos. Every case
states what it expects.
"""

import shutil
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from file_damage import Broken, Change, with_bytes

_FILES = Path(__file__).parents[1] / "data" / "heic"
_HELD = {path.stem: path.read_bytes() for path in _FILES.iterdir()}
QUADRANTS = "200 40 40, 40 180 60, 50 60 190, 230 220 200"
"""Colours of tests/data/heic/quadrants.heic, RGB to ten levels: top left and right, below left and right."""
_MEAN = "mean 130 120 120"


def _claimed(width: int, height: int) -> bytes:
    """The quadrants in a container that promises another size."""
    return _HELD["quadrants"].replace(struct.pack(">II", 96, 72), struct.pack(">II", width, height))


_HEIC: dict[str, tuple[bytes, str]] = {
    "8 bits": (_HELD["quadrants"], f"96 x 72 px, {_MEAN}: {QUADRANTS}"),
    "8 bits, 961 tiles": (_HELD["tiles"], f"1600 x 1200 px, {_MEAN}"),
    "alpha": (_HELD["alpha"], f"96 x 72 px, {_MEAN}: {QUADRANTS}"),
    "10 bits": (_HELD["ten-bits"], f"96 x 72 px, {_MEAN}: {QUADRANTS}"),
    "cut short": (_HELD["ten-bits"][:700], r"000\.jpg .* is damaged or was cut short"),
    "another size claimed": (_claimed(640, 480), r"000\.jpg .* is damaged or was cut short"),
    "20000 x 20000 claimed": (_claimed(20000, 20000), "20000 x 20000 pixels; expected at most"),
}  # fmt: skip
_MARKERS = {"FF00": b"\xff\x00", "FF01": b"\xff\x01", "FFD0": b"\xff\xd0"}
"""What is no marker (a stuffed zero), and markers without a length (ITU-T T.81, table B.1)."""
_SIDE = 32_700
"""Pixels: the largest sides of a JPEG that its decoder takes are 65,500; this one has 1,069 million."""


def hidden_size(marker: bytes, side: int = _SIDE) -> bytes:
    """A JPEG of side x side pixels that shows another frame header to whoever reads `marker` as the start of
    a segment: the large picture lies where that segment would be, a small one behind it.
    """
    small = _jpeg()[2:]
    large = bytearray(small)
    place = large.index(b"\xff\xc0")
    large[place + 5 : place + 9] = struct.pack(">HH", side, side)
    return b"\xff\xd8" + marker + struct.pack(">H", 2 + len(large)) + bytes(large) + small


def _jpeg() -> bytes:
    return cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


def _instead(data: bytes) -> Change:
    return with_bytes(lambda _: data)


def _renamed(suffix: str) -> Change:
    def change(path: Path, _: np.random.Generator) -> None:
        path.rename(path.with_suffix(suffix))

    return change


def _added(name: str, make: Callable[[], bytes]) -> Change:
    def change(path: Path, _: np.random.Generator) -> None:
        path.with_name(name).write_bytes(make())

    return change


def _in_a_folder(path: Path, _: np.random.Generator) -> None:
    inner = path.with_name("000.jpg of today")
    inner.mkdir()
    shutil.copyfile(path, inner / "001.jpg")


def _coded(suffix: str) -> bytes:
    return cv2.imencode(suffix, np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


_SAME_PHOTO: dict[str, Change] = {
    **{f"named {suffix}": _renamed(suffix) for suffix in (".JPG", ".jfif", ".JPE", ".Jpeg", ".png", ".hif")},
    "FF00 before the headers": with_bytes(lambda d: d[:2] + b"\xff\x00" + d[2:]),
    "fill bytes before a marker": with_bytes(lambda d: d[:2] + b"\xff\xff" + d[2:]),
    "notes beside it": _added("000.jpg.txt", lambda: b"first photo"),
    "a phone's edits beside it": _added("000.aae", lambda: b"<plist/>"),
    "a moving photo's film beside it": _added("000.mov", lambda: b"\0\0\0\x14ftypqt  " + bytes(99)),
    "a raw picture of it": _added("000.dng", lambda: b"II*\0" + bytes(99)),
}
_NAMED: dict[str, tuple[Change, str]] = {
    "a JPEG of another name": (
        _added("000.jpg.pic", _jpeg),
        r"000\.jpg\.pic is not used: drupe reads a JPEG only with a photo's suffix; rename it to \.jpg",
    ),
    "a second copy of a JPEG": (_added("000.jpg-2", _jpeg), "000.jpg-2 is not used: drupe reads a JPEG only"),
    "a HEIC of another name": (
        _added("000.jpg.live", lambda: _HELD["quadrants"]),
        r"000\.jpg\.live is not used: drupe reads a HEIC only .* rename it to \.heic",
    ),
    "a WebP picture": (_added("000.jpg.webp", lambda: _coded(".webp")), "drupe does not read WebP pictures"),
    "a TIFF": (_added("000.jpg.tif", lambda: _coded(".tiff")), "drupe does not read TIFF or raw pictures"),
    "a raw picture of its own": (
        _added("000.jpg.raf", lambda: b"FUJIFILMCCD-RAW " + bytes(99)),
        r"000\.jpg\.raf is not used: drupe does not read raw pictures; convert it to JPEG",
    ),
    "a file of no known kind": (_added("000.jpg.xyz", lambda: bytes(50)), "it is no JPEG, PNG or HEIC"),
    "photos in a folder within": (_in_a_folder, r"000\.jpg of today is not used: a folder within photos"),
    "a WebP picture under its name": (
        with_bytes(lambda _: _coded(".webp")),
        r"000\.jpg in .* is a picture of another format \(WebP\); expected a JPEG, PNG or HEIC",
    ),
    "AVIF under its name": (
        with_bytes(lambda _: b"\0\0\0\x18ftypavif" + bytes(300)),
        r"000\.jpg in .* is a picture of another format \(AVIF\); expected a JPEG, PNG or HEIC",
    ),
}


def photo_cases(photo: str, gel_frame: str) -> Iterator[Broken]:
    """Cases of one photo and of one gel frame."""
    heic = partial(Broken, format="photo (HEIC)", path=photo)
    for kind, (data, expects) in _HEIC.items():
        read = _MEAN in expects
        change = _instead(data)
        yield heic(kind=kind, change=change, command="photo" if read else "photos", expects=expects)
    for name, marker in _MARKERS.items():
        change = _instead(hidden_size(marker))
        kind = f"32700 x 32700 behind {name}"
        expects = r"32700 x 32700 pixels; expected at most 210 million|is no picture that can be decoded"
        hidden = partial(Broken, kind=kind, change=change)
        yield hidden(format="photo (JPEG)", path=photo, command="photos", expects=expects)
        expects = "a damaged picture, no PNG or JPEG, or more than 1000 MB of pixels"
        yield hidden(format="gel frame", path=gel_frame, expects=expects)
    named = partial(Broken, format="photo (name)", path=photo, command="photos")
    for kind, change in _SAME_PHOTO.items():
        yield named(kind=kind, change=change, expects="same")
    for kind, (change, expects) in _NAMED.items():
        yield named(kind=kind, change=change, expects=expects)
