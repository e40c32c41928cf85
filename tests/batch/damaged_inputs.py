"""The ways of breaking each file of a small sound batch, case and sources (sound_inputs.py)."""

import re
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from costly_files import costly
from damaged_photos import photo_cases
from damaged_recordings import NPY, recordings
from file_damage import (
    ANY,
    DIGITS,
    FACTORS,
    LINKS,
    NESTED,
    NUMBERS,
    TEXT,
    Broken,
    Change,
    line_changed,
    number_changed,
    put,
    with_bytes,
)
from foreign_files import others_files
from stated_units import stated_units

from recon.silhouettes.hull import ball
from recon.surface.mesh_file import mesh_bytes


def _text(format: str, path: str, kind: str, *, command: str = "check", numbers: int = 4) -> Iterator[Broken]:
    make = partial(Broken, format=format, path=path, command=command)
    for name, change in {**ANY, **LINKS, **TEXT, **NESTED[kind]}.items():
        for seed in range(2 if name in ("truncated", "1 bit", "8 bits", "random bytes") else 1):
            yield make(kind=name, change=change, seed=seed)
    for what in ("removed", "doubled", "shortened"):
        for seed in range(3):
            yield make(kind=f"line {what}", change=line_changed(what), seed=seed)
    for k in range(numbers):
        for new in (*NUMBERS, *DIGITS):
            yield make(kind=f"number {new[:9]}", change=number_changed(k * 3 + 1, new))
        for factor in FACTORS:
            yield make(kind=f"number times {factor:g}", change=number_changed(k * 3 + 1, factor))


def _binary(format: str, path: str, more: dict[str, Change], *, command: str = "check") -> Iterator[Broken]:
    make = partial(Broken, format=format, path=path, command=command)
    for name, change in {**ANY, **LINKS}.items():
        for seed in range(5 if "bit" in name or name == "truncated" else 1):
            yield make(kind=name, change=change, seed=seed)
    for name, change in more.items():
        yield make(kind=name, change=change)


# --- meshes


def _mesh(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Change:
    def done(path: Path, _: np.random.Generator) -> None:
        directions, faces = ball(3)
        radius = 28.0 if path.name == "fruit.ply" else 10.0
        put(path, mesh_bytes(*change(radius * directions, faces.copy())))

    return done


def _vertex(value: float) -> Change:
    def change(v: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v[7, 1] = value
        return v, f

    return _mesh(change)


def _ascii(path: Path, _: np.random.Generator, word: bytes = b"") -> None:
    directions, faces = ball(2)
    head = f"ply\nformat ascii 1.0\nelement vertex {len(directions)}\nproperty float x\nproperty float y\n"
    head += (
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [" ".join(f"{x:.5f}" for x in 28 * d) for d in directions]
    rows += [" ".join(map(str, (3, *f))) for f in faces]
    data = (head + "\n".join(rows) + "\n").encode()
    put(path, data.replace(b"28.00000", word, 1) if word else data)


MESH: dict[str, Change] = {
    **{
        f"times {f:g}": _mesh(lambda v, g, f=f: (v * f, g)) for f in (1e-3, 0.1, 1 / 25.4, 10, 1e3, 1e9, 1e30)
    },
    **{f"a vertex at {v:g}": _vertex(v) for v in (np.nan, np.inf, 1e30, 500.0)},
    "two bodies": _mesh(
        lambda v, g: (np.concatenate([v, v + np.array([90, 0, 0])]), np.concatenate([g, g + len(v)]))
    ),
    "a face removed": _mesh(lambda v, g: (v, g[1:])),
    "inside out": _mesh(lambda v, g: (v, g[:, ::-1])),
    "a face twice": _mesh(lambda v, g: (v, np.concatenate([g, g[:1]]))),
    "flat": _mesh(lambda v, g: (v * [1, 1, 0], g)),
    "far away": _mesh(lambda v, g: (v + np.array([5e5, 0, 0]), g)),
    "ascii": _ascii,
    "ascii with a word": lambda p, r: _ascii(p, r, b"wide"),
    "ascii with nan": lambda p, r: _ascii(p, r, b"nan"),
    "10^9 vertices claimed": with_bytes(
        lambda d: re.sub(rb"element vertex \d+", b"element vertex 999999999", d)
    ),
    "10^5000 faces claimed": with_bytes(
        lambda d: re.sub(rb"element face \d+", b"element face " + b"9" * 5000, d)
    ),
    "negative count": with_bytes(lambda d: re.sub(rb"element face \d+", b"element face -5", d)),
    "one more vertex claimed": with_bytes(
        lambda d: re.sub(rb"element vertex (\d+)", lambda m: b"element vertex %d" % (int(m[1]) + 1), d)
    ),
}


# --- pictures


def _png(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header + bytes(40) + b"IEND\xaeB`\x82"


def _jpeg(width: int, height: int) -> Callable[[bytes], bytes]:
    def make(_: bytes) -> bytes:
        data = bytearray(cv2.imencode(".jpg", np.full((120, 160, 3), 90, np.uint8))[1].tobytes())
        place = data.index(b"\xff\xc0")
        data[place + 5 : place + 9] = struct.pack(">HH", height, width)
        return bytes(data)

    return make


def _picture(shape: tuple[int, ...], kind: type = np.uint8) -> Change:
    def change(path: Path, rng: np.random.Generator) -> None:
        suffix = path.suffix if path.suffix == ".png" or kind is np.uint8 else ".png"
        put(path, cv2.imencode(suffix, rng.integers(0, 255, shape).astype(kind))[1].tobytes())

    return change


PICTURE: dict[str, Change] = {
    "32000 x 32000 claimed (JPEG)": with_bytes(_jpeg(32000, 32000)),
    "65000 x 100 claimed (JPEG)": with_bytes(_jpeg(65000, 100)),
    "60000 x 60000 claimed (PNG)": with_bytes(lambda _: _png(60000, 60000)),
    "1 x 60000": _picture((60000, 1, 3)),
    "grey": _picture((120, 160)),
    "16 bits": _picture((120, 160, 3), np.uint16),
    "4 channels": lambda p, r: (
        _picture((120, 160, 4))(p, r) if p.suffix == ".png" else _picture((120, 160))(p, r)
    ),
    "2 x 2": _picture((2, 2, 3)),
    "bitmap": with_bytes(lambda _: cv2.imencode(".bmp", np.zeros((90, 90, 3), np.uint8))[1].tobytes()),
    "TIFF": with_bytes(lambda _: cv2.imencode(".tiff", np.zeros((90, 90, 3), np.uint8))[1].tobytes()),
    "HEIF head": with_bytes(lambda _: b"\0\0\0\x18ftypheic" + bytes(300)),
}


def cases() -> list[Broken]:
    """Every case, always the same."""
    first, second, raw = "batch/fruits/A", "batch/fruits/B", "batch/fruits/B/grasps/raw"
    return [
        *_text("batch.toml", "batch/batch.toml", "toml", numbers=6),
        *_text("fruits.csv", "batch/fruits.csv", "csv", numbers=3),
        *_text("mat.json", "batch/mat.json", "json", numbers=3),
        *_text("category TOML", "batch/mine.toml", "toml", numbers=4),
        *_text("grasp.toml", f"{raw}/grasp.toml", "toml", numbers=3),
        *_text("sensor file", f"{raw}/sensor.toml", "toml", numbers=4),
        *_text("log.csv", f"{raw}/log.csv", "csv", numbers=2),
        *_text("case.toml", "case/case.toml", "toml", command="case", numbers=1),
        *_text("table of fields", "sources/fields.csv", "csv", command="convert", numbers=2),
        *_binary("fruit.ply", f"{first}/fruit.ply", MESH),
        *_binary("pit.ply", f"{first}/pit.ply", MESH),
        *_binary("photo (JPEG)", f"{second}/photos/000.jpg", PICTURE),
        *_binary("photo (PNG)", f"{second}/photos/002.png", PICTURE),
        *_binary("gel frame", f"{raw}/left/reference.png", PICTURE),
        *photo_cases(f"{second}/photos/000.jpg", f"{raw}/left/reference.png"),
        *_binary("recording", f"{first}/grasps/grasp-1.h5", recordings()),
        *_binary("ONNX", "batch/model.onnx", {}),
        *_binary("field arrays (.npz)", "sources/fields.npz", {}, command="convert"),
        *_binary("Tac3D array", "sources/tac3d/AD2/3D_Forces.npy", NPY, command="convert"),
        *(
            Broken(format="files of others", kind=kind, path=path, change=change, expects=expects)
            for kind, path, change, expects in others_files()
        ),
        *(
            Broken(
                format="units",
                kind=kind,
                path="sources/press.csv",
                change=c,
                command="press",
                expects=expects,
            )
            for kind, c, expects in stated_units()
        ),
        *costly(),
    ]
