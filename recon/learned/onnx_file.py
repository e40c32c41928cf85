"""Whether a file can be an ONNX model, and which files it keeps its numbers in, told without loading it."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from pipeline.files.plain_file import NO_LFS_FILE, is_lfs_pointer, not_plain, size
from recon.recon_failure import ReconFailure, ReconProblem

MOST_BYTES = 4_000_000_000
"""The largest that a protobuf message can be is 2 GB; what is larger keeps its numbers beside it."""
MOST_FIELDS, DEEPEST = 3_000_000, 50
"""Of a model: a network of 10,000 nodes has some 300,000 fields, 6 levels deep."""
GRAPH, OPSET, HIGHEST_FIELD = 7, 8, 1000
"""Numbers of the fields `graph` and `opset_import` in onnx.proto, and a number beyond all of its fields."""
EXTERNAL = "entry of external data"
PARTS: dict[str, dict[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: EXTERNAL},
}
"""Messages of onnx.proto, and which of their fields are messages that can hold tensors."""
KEY, VALUE = 1, 2
"""Fields of an entry of external data: its key, such as `location`, and its value."""
MOST_PATH_BYTES = 1000
"""Of a file's name in a model, with its folders. Set by hand: longer keys and values are other data."""


class _Malformed(Exception):
    """The bytes are no protobuf message."""


def require_onnx(model: Path) -> None:
    """Refuse what is no plain file, whose bytes are no ONNX model's from the first to the last field, and
    what keeps numbers elsewhere than in plain files of its folder.

    An ONNX file is one protobuf message (onnx.proto, ModelProto): fields one after the other, each with its
    number, kind and length, which must fill the file exactly, and among them the graph (7) and the opset (8).
    Raises ReconFailure (bad-geometry-model).
    """
    if wrong := not_plain(model):
        raise bad_model(model, wrong, "an ONNX file")
    length = model.stat().st_size
    if length > MOST_BYTES:
        raise bad_model(model, f"is larger than {size(MOST_BYTES)}", "an ONNX file below that")
    if is_lfs_pointer(model):
        raise bad_model(model, NO_LFS_FILE, "the model itself")
    try:
        fields, locations = _looked_through(model)
    except _Malformed:
        raise bad_model(model, "is no ONNX model, or was cut short", "a whole ONNX file") from None
    if not {GRAPH, OPSET} <= fields:
        raise bad_model(model, "is no ONNX model (it holds no graph)", "an ONNX file")
    for location in locations:
        if wrong := _location_fault(model, location):
            expected = "plain files in the folder of the model, and no links"
            raise bad_model(model, f'keeps numbers in "{location[:200]}", which {wrong}', expected)


def model_files(model: Path) -> tuple[Path, ...]:
    """The model, and the files in its folder that it keeps numbers in; the model alone where it is none."""
    try:
        require_onnx(model)
        _, locations = _looked_through(model)
    except (ReconFailure, OSError):
        return (model,)
    return (model, *(model.parent / location for location in locations))


def _location_fault(model: Path, location: str) -> str:
    """Why the file is not used; empty where it is a plain file in the model's folder or below it."""
    parts = Path(location).parts
    if not parts or Path(location).is_absolute() or ".." in parts:
        return "is not in the folder of the model"
    place = model.parent
    for part in parts:
        place = place / part
        try:
            mode = place.lstat().st_mode
        except (OSError, ValueError):
            return "does not exist"
        if stat.S_ISLNK(mode):
            return "is a link"
    return not_plain(place)


def _looked_through(model: Path) -> tuple[set[int], tuple[str, ...]]:
    """Numbers of the outermost fields, and the files that tensors name; raises _Malformed."""
    outermost: set[int] = set()
    locations: dict[str, None] = {}
    with model.open("rb") as file:
        left = [(0, os.fstat(file.fileno()).st_size, "model", 0)]
        fields = 0
        while left:
            start, end, message, depth = left.pop()
            entry: dict[int, str] = {}
            for number, kind, at, length in _fields(file, start, end):
                fields += 1
                if fields > MOST_FIELDS:
                    raise _Malformed
                if depth == 0:
                    outermost.add(number)
                if message == EXTERNAL and kind == 2 and length <= MOST_PATH_BYTES:
                    entry[number] = _text(file, at, length)
                inner = PARTS.get(message, {}).get(number)
                if inner and kind == 2:
                    if depth == DEEPEST:
                        raise _Malformed
                    left.append((at, at + length, inner, depth + 1))
            if entry.get(KEY) == "location":
                locations[entry.get(VALUE, "")] = None
    return outermost, tuple(locations)


def _fields(file: BinaryIO, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Number, kind, first byte and length of each field of a message; raises _Malformed."""
    at = start
    while at < end:
        file.seek(at)
        key = _varint(file)
        number, kind = (0, 7) if key is None else (key >> 3, key & 7)
        length = {1: 8, 5: 4}.get(kind, 0)
        if kind in (0, 2):
            value = _varint(file)
            if value is None:
                raise _Malformed
            length = value if kind == 2 else 0
        at = file.tell()
        if kind not in (0, 1, 2, 5) or not 1 <= number <= HIGHEST_FIELD or at + length > end:
            raise _Malformed
        yield number, kind, at, length
        at += length


def _text(file: BinaryIO, at: int, length: int) -> str:
    file.seek(at)
    return file.read(length).decode(errors="replace")


def _varint(file: BinaryIO) -> int | None:
    """The next whole number in protobuf's coding, seven bits a byte; None where it does not end."""
    value = 0
    for shift in range(0, 70, 7):
        byte = file.read(1)
        if not byte:
            return None
        value |= (byte[0] & 0x7F) << shift
        if byte[0] < 0x80:
            return value
    return None


def bad_model(model: Path, fault: str, expected: str) -> ReconFailure:
    """The failure that a model is not what was expected."""
    return ReconProblem.BAD_GEOMETRY_MODEL.failure(
        f"The geometry model {model} {fault}; expected {expected}."
    )
