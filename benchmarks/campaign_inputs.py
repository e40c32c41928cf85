"""The ways of breaking each file of a small sound batch, case and sources (campaign_sound.py)."""

import os
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import h5py
import numpy as np

from recon.silhouettes.hull import ball
from recon.surface.mesh_file import mesh_bytes

Change = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True, kw_only=True)
class Broken:
    """One case: which file of the sound folders is changed, how, and which command then reads it."""

    format: str
    kind: str
    path: str
    change: Change
    command: str = "check"
    seed: int = 0


# --- changes of any file


def _flip(count: int) -> Change:
    def change(path: Path, rng: np.random.Generator) -> None:
        data = np.frombuffer(path.read_bytes(), np.uint8).copy()
        places = rng.integers(0, len(data), count)
        data[places] ^= (1 << rng.integers(0, 8, count)).astype(np.uint8)
        _put(path, data.tobytes())

    return change


def _cut(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    _put(path, data[: int(rng.integers(1, len(data)))])


def _noise(path: Path, rng: np.random.Generator) -> None:
    _put(path, rng.bytes(int(rng.integers(1, 5000))))


def _put(path: Path, data: bytes) -> None:
    path.unlink()
    path.write_bytes(data)


def _with(make: Callable[[bytes], bytes]) -> Change:
    return lambda path, _: _put(path, make(path.read_bytes()))


def _instead(make: Callable[[Path], None]) -> Change:
    def change(path: Path, _: np.random.Generator) -> None:
        kept = path.with_name(f"kept-{path.name}.sound")
        path.rename(kept)
        make(path)

    return change


ANY: dict[str, Change] = {
    "zero length": _with(lambda _: b""),
    "truncated": _cut,
    "random bytes": _noise,
    "1 bit": _flip(1),
    "8 bits": _flip(8),
    "256 bits": _flip(256),
    "zeroed head": _with(lambda d: bytes(16) + d[16:]),
    "doubled": _with(lambda d: d + d),
    "other format": _with(lambda _: b"%PDF-1.7\n" + bytes(range(256)) * 8),
}
LINKS: dict[str, Change] = {
    "link to a file": _instead(lambda p: p.symlink_to(p.with_name(f"kept-{p.name}.sound"))),
    "link to nothing": _instead(lambda p: p.symlink_to("gone")),
    "link to itself": _instead(lambda p: p.symlink_to(p.name)),
    "link to a device": _instead(lambda p: p.symlink_to("/dev/zero")),
    "named pipe": _instead(lambda p: os.mkfifo(p)),
    "folder": _instead(lambda p: p.mkdir()),
    "another file": _instead(lambda p: p.symlink_to("/etc/passwd")),
}
TEXT: dict[str, Change] = {
    "not UTF-8": _with(lambda d: d[: len(d) // 2] + b"\xff\xfe\xe9" + d[len(d) // 2 :]),
    "UTF-16": _with(lambda d: d.decode().encode("utf-16")),
    "byte order mark": _with(lambda d: b"\xef\xbb\xbf" + d),
    "zero byte": _with(lambda d: d[:9] + b"\0" + d[9:]),
    "CRLF": _with(lambda d: d.replace(b"\n", b"\r\n")),
    "5 MB of one line": _with(lambda d: d + b"x" * 5_000_000),
    "escape sequences": _with(lambda d: d.replace(b'"', b'"\x1b[31m', 2)),
}
NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e300",
    "1e-300",
    '"text"',
    "true",
    "[1]",
    "",
    "1" * 5000,
    "1" * 400,
)
FACTORS = (10.0, 0.1, 1000.0, 0.001, -1.0)


def _number(which: int, new: str | float) -> Change:
    """The which-th number of a text replaced, or multiplied."""

    def change(path: Path, _: np.random.Generator) -> None:
        text = path.read_text()
        found = list(re.finditer(r"(?<![\w.\"-])-?\d+(\.\d+)?(?![\w.-])", text))
        one = found[which % len(found)]
        said = new if isinstance(new, str) else f"{float(one[0]) * new:g}"
        _put(path, (text[: one.start()] + said + text[one.end() :]).encode())

    return change


def _line(what: str) -> Change:
    def change(path: Path, rng: np.random.Generator) -> None:
        lines = path.read_text().splitlines()
        k = int(rng.integers(len(lines)))
        new = {"removed": [], "doubled": [lines[k]] * 2, "shortened": [lines[k][: len(lines[k]) // 2]]}[what]
        _put(path, "\n".join([*lines[:k], *new, *lines[k + 1 :], ""]).encode())

    return change


NESTED = {
    "toml": {
        "nested 5000 deep": _with(lambda d: b"z = " + b"[" * 5000 + b"]" * 5000 + b"\n" + d),
        "key of 9000 parts": _with(lambda d: b".".join([b"a"] * 9000) + b" = 1\n" + d),
    },
    "json": {"nested 5000 deep": _with(lambda d: b'{"a":' * 5000 + d + b"}" * 5000)},
    "csv": {
        "cell of 200,000": _with(lambda d: d.rstrip() + b"," + b"9" * 200_000 + b"\n"),
        "open quotation mark": _with(lambda d: d.replace(b",", b',"', 1)),
        "semicolons": _with(lambda d: d.replace(b",", b";")),
        "a column twice": _with(lambda d: d.replace(b"\n", b",1\n").replace(b",1", b",time_s", 1)),
        "formula": _with(lambda d: d.replace(b"\n", b",=cmd|' /C calc'!A0\n", 2)),
    },
}


def _text(format: str, path: str, kind: str, *, command: str = "check", numbers: int = 4) -> Iterator[Broken]:
    make = partial(Broken, format=format, path=path, command=command)
    for name, change in {**ANY, **LINKS, **TEXT, **NESTED[kind]}.items():
        for seed in range(2 if name in ("truncated", "1 bit", "8 bits", "random bytes") else 1):
            yield make(kind=name, change=change, seed=seed)
    for what in ("removed", "doubled", "shortened"):
        for seed in range(3):
            yield make(kind=f"line {what}", change=_line(what), seed=seed)
    for k in range(numbers):
        for new in NUMBERS:
            yield make(kind=f"number {new[:9]}", change=_number(k * 3 + 1, new))
        for factor in FACTORS:
            yield make(kind=f"number times {factor:g}", change=_number(k * 3 + 1, factor))


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
        _put(path, mesh_bytes(*change(radius * directions, faces.copy())))

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
    _put(path, data.replace(b"28.00000", word, 1) if word else data)


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
    "10^9 vertices claimed": _with(lambda d: re.sub(rb"element vertex \d+", b"element vertex 999999999", d)),
    "10^5000 faces claimed": _with(lambda d: re.sub(rb"element face \d+", b"element face " + b"9" * 5000, d)),
    "negative count": _with(lambda d: re.sub(rb"element face \d+", b"element face -5", d)),
    "one more vertex claimed": _with(
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
        _put(path, cv2.imencode(suffix, rng.integers(0, 255, shape).astype(kind))[1].tobytes())

    return change


PICTURE: dict[str, Change] = {
    "32000 x 32000 claimed (JPEG)": _with(_jpeg(32000, 32000)),
    "65000 x 100 claimed (JPEG)": _with(_jpeg(65000, 100)),
    "60000 x 60000 claimed (PNG)": _with(lambda _: _png(60000, 60000)),
    "1 x 60000": _picture((60000, 1, 3)),
    "grey": _picture((120, 160)),
    "16 bits": _picture((120, 160, 3), np.uint16),
    "4 channels": lambda p, r: (
        _picture((120, 160, 4))(p, r) if p.suffix == ".png" else _picture((120, 160))(p, r)
    ),
    "2 x 2": _picture((2, 2, 3)),
    "bitmap": _with(lambda _: cv2.imencode(".bmp", np.zeros((90, 90, 3), np.uint8))[1].tobytes()),
    "TIFF": _with(lambda _: cv2.imencode(".tiff", np.zeros((90, 90, 3), np.uint8))[1].tobytes()),
    "HEIF head": _with(lambda _: b"\0\0\0\x18ftypheic" + bytes(300)),
}


# --- recordings


def _h5(change: Callable[[h5py.File], None]) -> Change:
    def done(path: Path, _: np.random.Generator) -> None:
        _put(path, path.read_bytes())
        with h5py.File(path, "r+") as file:
            change(file)

    return done


def _field(name: str, make: Callable[[np.ndarray], object]) -> Change:
    def change(file: h5py.File) -> None:
        values = file[name][()]
        del file[name]
        file[name] = make(values)

    return _h5(change)


def _lies(name: str, how: str) -> Change:
    def change(file: h5py.File) -> None:
        shape = file[name].shape
        if how == "moved":
            file.move(name, "elsewhere")
            file[name] = h5py.SoftLink("/elsewhere")
            return
        del file[name]
        if how == "external":
            file[name] = h5py.ExternalLink("/etc/passwd", "/x")
        elif how == "raw":
            file.create_dataset(name, shape, "f8", external=[("/dev/zero", 0, 8 * int(np.prod(shape)))])
        elif how == "claimed":
            file.create_dataset(name, (10**9, *shape[1:]), "f4", chunks=True)
        elif how == "chunk":
            most = (None, *shape[1:])
            file.create_dataset(name, shape, "f4", chunks=(3 * 10**7, *shape[1:]), maxshape=most)
        elif how == "virtual":
            layout = h5py.VirtualLayout(shape=shape, dtype="f8")
            layout[...] = h5py.VirtualSource("other.h5", "x", shape=shape)
            file.create_virtual_dataset(name, layout)
        elif how == "group":
            file.create_group(name)
        elif how == "text":
            file.create_dataset(name, data=["x"] * 5, dtype=h5py.string_dtype())
        elif how == "objects":
            file.create_dataset(name, data=[file.ref] * 3, dtype=h5py.ref_dtype)

    return _h5(change)


def _set(values: np.ndarray, number: float) -> np.ndarray:
    out = np.array(values, np.float64)
    out[(-1,) * out.ndim] = number
    return out


def _attribute(place: str, name: str, value: object) -> Change:
    def change(file: h5py.File) -> None:
        held = file[place].attrs
        if value is None:
            del held[name]
        else:
            held[name] = value

    return _h5(change)


def _recordings() -> dict[str, Change]:
    fields = (
        "time_s",
        "aperture_mm",
        *(f"pads/left/{n}" for n in ("pose", "rest_mm", "displacement_mm", "force_N")),
    )
    said: dict[str, Change] = {}
    for name in fields:
        for number in (np.nan, np.inf, -np.inf, 1e300, -1e30):
            said[f"{name}: {number:g}"] = _field(name, partial(_set, number=number))
        for factor in (1e3, 1e-3, 1e6, -1.0, 0.0):
            said[f"{name}: times {factor:g}"] = _field(name, lambda v, f=factor: v * f)
        said[f"{name}: a frame less"] = _field(name, lambda v: v[:-1])
        said[f"{name}: empty"] = _field(name, lambda v: v[:0])
        said[f"{name}: backwards"] = _field(name, lambda v: v[::-1])
        said[f"{name}: a scalar"] = _field(name, lambda _: 1.0)
        said[f"{name}: removed"] = _h5(lambda file, n=name: file.__delitem__(n))
        for how in ("moved", "external", "raw", "claimed", "chunk", "virtual", "group", "text", "objects"):
            said[f"{name}: {how}"] = _lies(name, how)
    pads = [
        ("pads/left", n) for n in ("gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm", "thickness_mm", "E_MPa", "nu")
    ]
    root = [("/", n) for n in ("format", "version", "fruit_id", "category", "loading", "sensor")]
    values = (
        None,
        0.0,
        -1.0,
        np.nan,
        np.inf,
        1e300,
        "x" * 3000,
        "a\x1b[31mb",
        np.zeros(7000),
        np.bytes_(b"\xff\xfe"),
    )
    for place, name in (*root, *pads):
        for k, value in enumerate(values):
            said[f"attribute {name}: {k}"] = _attribute(place, name, value)
    return said


def _arrays(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def done(path: Path, _: np.random.Generator) -> None:
        values = change(np.load(path))
        path.unlink()
        np.save(path, values, allow_pickle=True)

    return done


NPY: dict[str, Change] = {
    "10^12 values claimed": _with(lambda d: d.replace(b"(20,", b"(999999999999,")),
    "nan": _arrays(lambda v: v * np.nan),
    "1e300": _arrays(lambda v: v * 1e300 + 1e300),
    "a frame less": _arrays(lambda v: v[:-1]),
    "objects": _arrays(lambda _: np.array([{}] * 20, object)),
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
        *_binary("recording", f"{first}/grasps/grasp-1.h5", _recordings()),
        *_binary("ONNX", "batch/model.onnx", {}),
        *_binary("field arrays (.npz)", "sources/fields.npz", {}, command="convert"),
        *_binary("Tac3D array", "sources/tac3d/AD2/3D_Forces.npy", NPY, command="convert"),
    ]
