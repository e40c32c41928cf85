"""The pictures of a fruit as the report holds them: small ones inside the page, the files beside it."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from pipeline.batch.cache import cached, stage_key
from pipeline.batch.layout import FruitResults, Results
from pipeline.batch.stage_record import StageRecord
from pipeline.files.whole_file import NotWritten
from reports.entries import FruitPictures, Picture
from reports.photo import webp_within

MANY = 450
"""Fruit in a batch; beyond it a page with the pictures of each would pass 25 MB: 500 took 27 MB."""
MANY_SCENES = 100
"""Fruit in a batch; beyond it the page has none in three dimensions, which take 56 kB each in base64: 5.6 MB.
Set by hand."""


class _Room(NamedTuple):
    """What a picture may take in the page: bytes as WebP, and its longer side."""

    most_bytes: int
    longest_px: int


_ROOMS: dict[str, _Room] = {
    "photo": _Room(8_500, 420),
    "outlines": _Room(0, 0),
    "mesh": _Room(7_000, 640),
    "surface_sd": _Room(5_500, 420),
}
"""Bytes and pixels by picture. Together 21 000 bytes, in a page (base64, four characters for three bytes)
28 kB; the outlines are a link to their file."""
_ROOMS_OF_MANY: dict[str, _Room] = {
    "photo": _Room(2_500, 220),
    "outlines": _Room(0, 0),
    "mesh": _Room(3_500, 360),
    "surface_sd": _Room(0, 0),
}
"""The same beyond MANY fruit: 2000 of them take 16 MB; the maps are links to their files alone."""


class _Thumbnails(StageRecord):
    """WebP bytes by picture, empty where the page has its file alone."""

    webp: dict[str, UInt8[np.ndarray, " _"]]


class ReportPictures:
    """Small pictures of fruit, made once: kept here while a run lasts, and with the fruit's stages."""

    def __init__(self, results: Results, *, fruits: int) -> None:
        self._root = results.root
        self._rooms = _ROOMS_OF_MANY if fruits > MANY else _ROOMS
        self._with_scenes = fruits <= MANY_SCENES
        self._made: dict[tuple[str, tuple[tuple[str, int, int], ...]], FruitPictures] = {}

    def of(self, files: FruitResults, *, measured: bool) -> FruitPictures:
        """Pictures of one fruit; none of one without a mesh (not `measured`)."""
        wanted = {
            "photo": files.photo,
            "outlines": files.outlines,
            "mesh": files.picture,
            "surface_sd": files.surface_sd,
        }
        there = {name: path for name, path in wanted.items() if measured and path.is_file()}
        if not there:
            return FruitPictures()
        state = tuple((name, *_state(path)) for name, path in there.items())
        key = (str(files.root), state)
        if key not in self._made:
            self._made[key] = self._pictures(files, there)
        if not (self._with_scenes and files.scene.is_file()):
            return self._made[key]
        return replace(self._made[key], scene=files.scene.read_bytes())

    def _pictures(self, files: FruitResults, there: dict[str, Path]) -> FruitPictures:
        key = stage_key(
            "report-pictures",
            files=there.values(),
            settings={name: list(self._rooms[name]) for name in there},
            rooms=("reports",),
        )
        made: list[_Thumbnails] = []

        def compute() -> _Thumbnails:
            made.append(self._thumbnails(there))
            return made[-1]

        with suppress(NotWritten):
            made.append(cached(files.cache, "report-pictures", key, compute, record=_Thumbnails))
        shown: dict[str, Any] = {
            name: Picture(webp=made[-1].webp[name].tobytes(), file=_from(self._root, path))
            for name, path in there.items()
        }
        return FruitPictures(**shown)

    def _thumbnails(self, there: dict[str, Path]) -> _Thumbnails:
        webp = {}
        for name, path in there.items():
            most_bytes, longest_px = self._rooms[name]
            coded = b""
            if most_bytes:
                coded = webp_within(path.read_bytes(), most_bytes=most_bytes, longest_px=longest_px)
            webp[name] = np.frombuffer(coded, np.uint8)
        return _Thumbnails(webp=webp)


def _state(path: Path) -> tuple[int, int]:
    """What changes when a file is written anew: time (ns) and size (bytes)."""
    said = path.stat()
    return said.st_mtime_ns, said.st_size


def _from(root: Path, path: Path) -> str:
    """The path from the page's folder, with forward slashes."""
    return path.absolute().relative_to(root.absolute()).as_posix()
