"""Whether a file may be opened as an ONNX model, and which files it keeps its numbers in."""

import mmap
import re
from pathlib import Path

from pipeline.files.plain_file import NO_LFS_FILE, is_lfs_pointer, not_plain, size
from recon.recon_failure import ReconFailure, ReconProblem

MOST_BYTES = 4_000_000_000
"""The largest that a protobuf message can be is 2 GB; what is larger keeps its numbers beside it."""
LOCATION = re.compile(rb"\n\x08location\x12.", re.DOTALL)
"""Key of an entry of external data (onnx.proto, StringStringEntryProto), and the length of the path after it:
one byte, as longer paths are refused."""


def require_onnx(model: Path) -> None:
    """Refuse what is no plain file, and a model that keeps numbers outside of plain files of its folder.

    Raises ReconFailure (bad-geometry-model).
    """
    if wrong := not_plain(model):
        raise bad_model(model, wrong, "an ONNX file")
    if not 0 < model.stat().st_size <= MOST_BYTES:
        raise bad_model(model, f"is empty or larger than {size(MOST_BYTES)}", "a whole ONNX file")
    if is_lfs_pointer(model):
        raise bad_model(model, NO_LFS_FILE, "the model itself")
    for location in _locations(model):
        if wrong := _location_fault(model, location):
            expected = "plain files in the folder of the model, and no links"
            raise bad_model(model, f'keeps numbers in "{location[:200]}", which {wrong}', expected)


def model_files(model: Path) -> tuple[Path, ...]:
    """The model, and the files in its folder that it keeps numbers in; the model alone where it is none."""
    try:
        require_onnx(model)
        return (model, *(model.parent / location for location in _locations(model)))
    except (ReconFailure, OSError):
        return (model,)


def _locations(model: Path) -> tuple[str, ...]:
    """Paths of the files that tensors name, each once."""
    with model.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        ends = [(match.end(), content[match.end() - 1]) for match in LOCATION.finditer(content)]
        paths = [content[start : start + length].decode(errors="replace") for start, length in ends]
    return tuple(dict.fromkeys(paths))


def _location_fault(model: Path, location: str) -> str:
    """Why the file is not used; empty where it is a plain file in the model's folder or below it."""
    path = Path(location)
    if not path.parts or path.is_absolute() or ".." in path.parts:
        return "is not in the folder of the model"
    places = [model.parent.joinpath(*path.parts[: k + 1]) for k in range(len(path.parts))]
    if any(place.is_symlink() for place in places):
        return "is a link"
    return not_plain(places[-1])


def bad_model(model: Path, fault: str, expected: str) -> ReconFailure:
    """The failure that a model is not what was expected."""
    return ReconProblem.BAD_GEOMETRY_MODEL.failure(
        f"The geometry model {model} {fault}; expected {expected}."
    )
