"""Whether a file can be an ONNX model, told from its outermost fields without loading it."""

import os
from pathlib import Path
from typing import BinaryIO

from recon.plain_file import NO_LFS_FILE, is_lfs_pointer, not_plain, size
from recon.recon_failure import ReconFailure, ReconProblem

MOST_BYTES = 4_000_000_000
"""The largest that a protobuf message can be is 2 GB; what is larger keeps its numbers beside it."""
GRAPH, OPSET, HIGHEST_FIELD = 7, 8, 1000
"""Numbers of the fields `graph` and `opset_import` in onnx.proto, and a number beyond all of its fields."""


def require_onnx(model: Path) -> None:
    """Refuse what is no plain file, or whose bytes are no ONNX model's from the first to the last field.

    An ONNX file is one protobuf message (onnx.proto, ModelProto): fields one after the other, each with its
    number, kind and length, which must fill the file exactly, and among them the graph (7) and the opset (8).
    """
    if wrong := not_plain(model):
        raise bad_model(model, wrong, "an ONNX file")
    length = model.stat().st_size
    if length > MOST_BYTES:
        raise bad_model(model, f"is larger than {size(MOST_BYTES)}", "an ONNX file below that")
    if is_lfs_pointer(model):
        raise bad_model(model, NO_LFS_FILE, "the model itself")
    with model.open("rb") as file:
        found: set[int] = set()
        while file.tell() < length:
            key = _varint(file)
            number, kind = (0, 7) if key is None else (key >> 3, key & 7)
            skip = {1: 8, 5: 4}.get(kind, 0)
            if kind in (0, 2):
                value = _varint(file)
                number = 0 if value is None else number
                skip = (value or 0) if kind == 2 else 0
            elif kind not in (1, 5):
                number = 0
            if not 1 <= number <= HIGHEST_FIELD or file.tell() + skip > length:
                raise bad_model(model, "is no ONNX model, or was cut short", "a whole ONNX file")
            found.add(number)
            file.seek(skip, os.SEEK_CUR)
    if not {GRAPH, OPSET} <= found:
        raise bad_model(model, "is no ONNX model (it holds no graph)", "an ONNX file")


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


def bad_model(model: Path, found: str, expected: str) -> ReconFailure:
    """The failure that a model is not what was expected."""
    return ReconFailure(
        ReconProblem.BAD_GEOMETRY_MODEL, f"The geometry model {model} {found}; expected {expected}."
    )
