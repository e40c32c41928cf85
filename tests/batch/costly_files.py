"""Small files that ask for much memory or time, and files that lead a reader to other files."""

import io
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import cv2
import h5py
import numpy as np
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
    """So many zeros by deflate."""
    packer, block = zlib.compressobj(6), bytes(1_000_000)
    return b"".join(packer.compress(block) for _ in range(count // len(block))) + packer.flush()


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


def avi(width: int, height: int, frames: list[bytes]) -> bytes:
    """An AVI of JPEG frames; its header states `width` and `height`, whatever the frames are."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return name + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)

    def listed(name: bytes, data: bytes) -> bytes:
        return chunk(b"LIST", name + data)

    count = len(frames)
    main = struct.pack("<14I", 33333, 0, 0, 0x10, count, 0, 1, 0, width, height, 0, 0, 0, 0)
    stream = struct.pack(
        "<4s4sIHHIIIIIIIIhhhh", b"vids", b"MJPG", 0, 0, 0, 0, 1, 30, 0, count, 0, 0, 0, 0, 0,
        min(width, 32767), min(height, 32767),
    )  # fmt: skip
    bitmap = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 24, b"MJPG", 0, 0, 0, 0, 0)
    header = listed(b"strl", chunk(b"strh", stream) + chunk(b"strf", bitmap))
    header = listed(b"hdrl", chunk(b"avih", main) + header)
    body, index, place = b"", b"", 4
    for data in frames:
        index += b"00dc" + struct.pack("<III", 0x10, place, len(data))
        body += chunk(b"00dc", data)
        place = 4 + len(body)
    return chunk(b"RIFF", b"AVI " + header + listed(b"movi", body) + chunk(b"idx1", index))


def jpeg(side: int) -> bytes:
    """A square picture of one grey."""
    return cv2.imencode(".jpg", np.full((side, side, 3), 90, np.uint8))[1].tobytes()


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
        "8000 x 8000": lambda: avi(8000, 8000, [jpeg(8000)] * 5),
        "8000 x 8000 in a header of 64 x 48": lambda: avi(64, 48, [jpeg(8000)] * 5),
    }
    for name, make in sizes.items():
        path = f"{folder}/left.avi"
        yield Broken(format="video", kind=name, path=path, change=_video(make), expects=large)


# --- spreadsheets


def _xlsx(cells: dict[str, float], *, dimension: str = "A1:B2", sheet: str = "Trace") -> bytes:
    """A workbook with one sheet of numbers."""
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    rel = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    rows: dict[int, str] = {}
    for name, value in cells.items():
        row = int(name.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ"))
        rows[row] = rows.get(row, "") + f'<c r="{name}"><v>{value}</v></c>'
    data = "".join(f'<row r="{row}">{held}</row>' for row, held in sorted(rows.items()))
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{package}/content-types"><Default Extension="xml" '
        'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
        f'Type="{rel}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook {main} xmlns:r="{rel}"><sheets><sheet name="{sheet}" sheetId="1" '
        'r:id="r1"/></sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
        f'Type="{rel}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>',
        "xl/worksheets/sheet1.xml": f'<worksheet {main}><dimension ref="{dimension}"/><sheetData>{data}'
        "</sheetData></worksheet>",
    }
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            archive.writestr(name, '<?xml version="1.0" encoding="UTF-8"?>' + text)
    return held.getvalue()


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
