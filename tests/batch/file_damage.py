"""Changes that may happen to any file: bits flipped, cut, emptied, another thing in its place."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

Change = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True, kw_only=True)
class Broken:
    """One case: which file of the sound folders is changed or added, how, and which command then reads it.

    `expects`: "same" where every number must be read as from the sound input, otherwise a regular expression
    that the message must match; empty: any clear error, or any valid reading. Of the command "photo" it is
    the size and the colours that must be read; "photos" reads a folder of them.
    """

    format: str
    kind: str
    path: str
    change: Change
    command: str = "check"
    seed: int = 0
    expects: str = ""


def _flip(count: int) -> Change:
    def change(path: Path, rng: np.random.Generator) -> None:
        data = np.frombuffer(path.read_bytes(), np.uint8).copy()
        places = rng.integers(0, len(data), count)
        data[places] ^= (1 << rng.integers(0, 8, count)).astype(np.uint8)
        put(path, data.tobytes())

    return change


def _cut(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    put(path, data[: int(rng.integers(1, len(data)))])


def _noise(path: Path, rng: np.random.Generator) -> None:
    put(path, rng.bytes(int(rng.integers(1, 5000))))


def put(path: Path, data: bytes) -> None:
    """A file of its own in the place of what may be a link."""
    path.unlink()
    path.write_bytes(data)


def with_bytes(make: Callable[[bytes], bytes]) -> Change:
    """The whole file made anew of its bytes."""
    return lambda path, _: put(path, make(path.read_bytes()))


def with_hdf5(change: Callable[[h5py.File], None]) -> Change:
    """The file's own copy, changed through HDF5."""

    def changed(path: Path, _: np.random.Generator) -> None:
        put(path, path.read_bytes())
        with h5py.File(path, "r+") as file:
            change(file)

    return changed


def with_array(make: Callable[[np.ndarray], np.ndarray]) -> Change:
    """The array of a .npy file made anew."""

    def changed(path: Path, _: np.random.Generator) -> None:
        values = make(np.load(path))
        path.unlink()
        np.save(path, values, allow_pickle=True)

    return changed


def _instead(make: Callable[[Path], None]) -> Change:
    def change(path: Path, _: np.random.Generator) -> None:
        kept = path.with_name(f"kept-{path.name}.sound")
        path.rename(kept)
        make(path)

    return change


ANY: dict[str, Change] = {
    "zero length": with_bytes(lambda _: b""),
    "truncated": _cut,
    "random bytes": _noise,
    "1 bit": _flip(1),
    "8 bits": _flip(8),
    "256 bits": _flip(256),
    "zeroed head": with_bytes(lambda d: bytes(16) + d[16:]),
    "doubled": with_bytes(lambda d: d + d),
    "other format": with_bytes(lambda _: b"%PDF-1.7\n" + bytes(range(256)) * 8),
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
    "not UTF-8": with_bytes(lambda d: d[: len(d) // 2] + b"\xff\xfe\xe9" + d[len(d) // 2 :]),
    "UTF-16": with_bytes(lambda d: d.decode().encode("utf-16")),
    "byte order mark": with_bytes(lambda d: b"\xef\xbb\xbf" + d),
    "zero byte": with_bytes(lambda d: d[:9] + b"\0" + d[9:]),
    "CRLF": with_bytes(lambda d: d.replace(b"\n", b"\r\n")),
    "5 MB of one line": with_bytes(lambda d: d + b"x" * 5_000_000),
    "escape sequences": with_bytes(lambda d: d.replace(b'"', b'"\x1b[31m', 2)),
}
NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e300", "1e-300", '"text"', "true", "[1]", "")
DIGITS = ("1" * 5000, "1" * 400)
FACTORS = (10.0, 0.1, 1000.0, 0.001, -1.0)


def number_changed(which: int, new: str | float) -> Change:
    """The which-th number of a text replaced, or multiplied."""

    def change(path: Path, _: np.random.Generator) -> None:
        text = path.read_text()
        numbers = list(re.finditer(r"(?<![\w.\"-])-?\d+(\.\d+)?(?![\w.-])", text))
        number = numbers[which % len(numbers)]
        said = new if isinstance(new, str) else f"{float(number[0]) * new:g}"
        put(path, (text[: number.start()] + said + text[number.end() :]).encode())

    return change


def line_changed(what: str) -> Change:
    """One line of a text, drawn at random."""

    def change(path: Path, rng: np.random.Generator) -> None:
        lines = path.read_text().splitlines()
        k = int(rng.integers(len(lines)))
        new = {"removed": [], "doubled": [lines[k]] * 2, "shortened": [lines[k][: len(lines[k]) // 2]]}[what]
        put(path, "\n".join([*lines[:k], *new, *lines[k + 1 :], ""]).encode())

    return change


NESTED = {
    "toml": {"nested 5000 deep": with_bytes(lambda d: b"z = " + b"[" * 5000 + b"]" * 5000 + b"\n" + d)},
    "json": {"nested 5000 deep": with_bytes(lambda d: b'{"a":' * 5000 + d + b"}" * 5000)},
    "csv": {
        "cell of 200,000": with_bytes(lambda d: d.rstrip() + b"," + b"9" * 200_000 + b"\n"),
        "open quotation mark": with_bytes(lambda d: d.replace(b",", b',"', 1)),
        "semicolons": with_bytes(lambda d: d.replace(b",", b";")),
        "a column twice": with_bytes(lambda d: d.replace(b"\n", b",1\n").replace(b",1", b",time_s", 1)),
        "formula": with_bytes(lambda d: d.replace(b"\n", b",=cmd|' /C calc'!A0\n", 2)),
    },
}
