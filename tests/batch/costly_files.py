"""Small files that ask for much memory or time, and files that lead a reader to other files."""

import io
import os
import re
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import cv2
import h5py
import numpy as np
import openpyxl
from file_damage import Broken, Change, put, with_hdf5

# --- recordings


def _linked(place: str, target: str, *, pipe: bool = False) -> Change:
    """A link out of the recording; `pipe`: to a named pipe beside it, which would be waited for."""

    def change(file: h5py.File) -> None:
        if pipe:
            os.mkfifo(Path(file.filename).with_name(target))
        if place in file:
            del file[place]
        file[place] = h5py.ExternalLink(target, "/pads")

    return with_hdf5(change)


def _large(markers: int, pads: tuple[str, ...]) -> Change:
    """Pads with so many markers; only their places are stored, the fields are zero and take no room."""

    def change(file: h5py.File) -> None:
        for pad in pads:
            frames = len(file[f"pads/{pad}/force_N"])
            for name in ("rest_mm", "displacement_mm", "force_N"):
                del file[f"pads/{pad}/{name}"]
            across = np.arange(markers) / markers
            file[f"pads/{pad}/rest_mm"] = np.column_stack([across, across**2, across]).astype("f4")
            for name in ("displacement_mm", "force_N"):
                shape = (frames, markers, 3)
                file.create_dataset(f"pads/{pad}/{name}", shape, "f8", chunks=True, compression="gzip")

    return with_hdf5(change)


@cache
def _packed(count: int) -> bytes:
    """So many zeros by deflate, in equal blocks of a megabyte, each packed without the others."""
    packer, block = zlib.compressobj(), bytes(1_000_000)
    packed = [packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2)]
    end = zlib.compressobj(wbits=-zlib.MAX_WBITS).flush()
    checksum = struct.pack(">2H", count % 65521, 1)  # Adler-32 of zeros
    return packed[0] + (count // len(block) - 1) * packed[1] + end + checksum


def _unpacks_to(place: str, count: int) -> Change:
    """A chunk that unpacks to `count` bytes, whatever its shape says."""

    def change(file: h5py.File) -> None:
        shape = file[place].shape
        del file[place]
        data = file.create_dataset(place, shape, "f8", chunks=shape, compression="gzip")
        data.id.write_direct_chunk((0,) * len(shape), _packed(count))

    return with_hdf5(change)


def _recordings() -> Iterator[Broken]:
    path = "batch/fruits/A/grasps/grasp-1.h5"
    out = r"found a link, expected the field itself|found no such group"
    over = unpacked = r"found contents that are damaged, or take more than 500 MB of memory to read"
    changes: dict[str, tuple[Change, str]] = {
        "pads in another file": (_linked("pads", "other.h5"), out),
        "pads in a named pipe": (_linked("pads", "pipe", pipe=True), out),
        "a field in a named pipe": (_linked("pads/left/force_N", "pipe", pipe=True), out),
        "fields of 1 GB": (_large(2_000_000, ("left",)), over),
        "four fields of 144 MB": (_large(300_000, ("left", "right")), over),
        "a chunk that unpacks to 1 GB": (_unpacks_to("pads/left/force_N", 1_000_000_000), unpacked),
    }
    for kind, (change, expects) in changes.items():
        yield Broken(format="recording", kind=kind, path=path, change=change, expects=expects)


# --- videos


def _avi(side: int, *, claimed: tuple[int, int] | None = None) -> bytes:
    """An AVI of five square JPEG frames; `claimed`: width and height that its header states instead."""
    stated = struct.pack("<2i", *(claimed or (side, side)))
    return _written_avi(side).replace(struct.pack("<2i", side, side), stated)


@cache
def _written_avi(side: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (side, side))
        grey = np.full((side, side, 3), 90, np.uint8)
        for _ in range(5):
            writer.write(grey)
        writer.release()
        return path.read_bytes()


def _video(make: Callable[[], bytes]) -> Change:
    """A new file beside grasp.toml, which names it as the left pad's frames."""

    def change(path: Path, _: np.random.Generator) -> None:
        grasp = path.with_name("grasp.toml")
        text = grasp.read_text().replace("[pads.left]", f'[pads.left]\nframes = "{path.name}"', 1)
        put(grasp, text.encode())
        path.write_bytes(make())

    return change


def _videos() -> Iterator[Broken]:
    folder = "batch/fruits/B/grasps/raw"
    secret = b"other.avi"
    kind = r"left\.\w+: found no video of a kind that is read"
    large = r"left\.avi: found frames of 8000 x 8000 pixels"
    lists: dict[str, tuple[str, bytes]] = {
        "ffconcat list": ("left.avi", b"ffconcat version 1.0\nfile " + secret + b"\n"),
        "session description": ("left.avi", b"v=0\no=- 0 0 IN IP4 127.0.0.1\nm=video 9 RTP/AVP 26\n"),
        "a picture": ("left.avi", b"P6 2 2 255 " + bytes(12)),
    }
    for name, (file, data) in lists.items():
        change = _video(lambda data=data: data)
        yield Broken(format="video", kind=name, path=f"{folder}/{file}", change=change, expects=kind)
    sizes: dict[str, Callable[[], bytes]] = {
        "8000 x 8000": lambda: _avi(8000),
        "8000 x 8000 in a header of 64 x 48": lambda: _avi(8000, claimed=(64, 48)),
    }
    for name, make in sizes.items():
        path = f"{folder}/left.avi"
        yield Broken(format="video", kind=name, path=path, change=_video(make), expects=large)


# --- spreadsheets


def _xlsx(cells: dict[str, float]) -> bytes:
    """A workbook with one sheet of numbers, which states that it has four cells."""
    book, held, lying = openpyxl.Workbook(), io.BytesIO(), io.BytesIO()
    book.active.title = "Trace"
    for name, value in cells.items():
        book.active[name] = value
    book.save(held)
    with zipfile.ZipFile(held) as honest, zipfile.ZipFile(lying, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in honest.namelist():
            archive.writestr(
                name, re.sub(rb'<dimension ref="[^"]*"', b'<dimension ref="A1:B2"', honest.read(name))
            )
    return lying.getvalue()


def _spreadsheets() -> Iterator[Broken]:
    apart = r"trace\.xlsx: sheet Trace: found cells that take more than .* expected a smaller table"
    books = {
        "two cells far apart": _xlsx({"A1": 1.0, "XFD1048576": 2.0}),
        "cells down and across": _xlsx({"A1": 1.0, "A90000": 1.0, "ZZ2": 2.0}),
    }
    for kind, data in books.items():
        yield Broken(
            format="spreadsheet", kind=kind, path="sources/trace.xlsx", command="convert", expects=apart,
            change=lambda path, _, data=data: path.write_bytes(data),
        )  # fmt: skip


def costly() -> Iterator[Broken]:
    """Every case, always the same."""
    yield from _recordings()
    yield from _videos()
    yield from _spreadsheets()
