"""Checks that a file may be opened as an ONNX model, and finds its external data files."""

import mmap
import re
from pathlib import Path

from pipeline.files.plain_file import NO_LFS_FILE, is_lfs_pointer, not_plain, size
from recon.recon_failure import ReconFailure, ReconProblem

MOST_BYTES = 4_000_000_000
"""Largest model file. Protobuf messages have at most 2 GB; larger models keep weights in other files."""
LOCATION = re.compile(rb"\n\x08location\x12.", re.DOTALL)
"""Key of an external-data entry (onnx.proto, StringStringEntryProto), and the length of the path after it:
one byte, as longer paths are refused."""


def require_onnx(model: Path) -> None:
    """Raise ReconFailure (bad-geometry-model) unless the model is a plain file.

    Its external data must be in plain files in its folder or below.
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
    """The model and its external data files; the model alone if `require_onnx` refuses it."""
    try:
        require_onnx(model)
        return (model, *(model.parent / location for location in _locations(model)))
    except (ReconFailure, OSError):
        return (model,)


def _locations(model: Path) -> tuple[str, ...]:
    """Paths of the external data files, each once."""
    with model.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        ends = [(match.end(), content[match.end() - 1]) for match in LOCATION.finditer(content)]
        paths = [content[start : start + length].decode(errors="replace") for start, length in ends]
    return tuple(dict.fromkeys(paths))


def _location_fault(model: Path, location: str) -> str:
    """Why an external data file is refused; empty for a plain file in the model's folder or below."""
    path = Path(location)
    if not path.parts or path.is_absolute() or ".." in path.parts:
        return "is not in the folder of the model"
    places = [model.parent.joinpath(*path.parts[: k + 1]) for k in range(len(path.parts))]
    if any(place.is_symlink() for place in places):
        return "is a link"
    return not_plain(places[-1])


def bad_model(model: Path, fault: str, expected: str) -> ReconFailure:
    """The failure (bad-geometry-model) that states a model's fault and what was expected."""
    return ReconProblem.BAD_GEOMETRY_MODEL.failure(
        f"The geometry model {model} {fault}; expected {expected}."
    )
