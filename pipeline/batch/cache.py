"""Frozen records of stages, cached under the hash of their inputs: a second run computes only changes."""

import hashlib
import io
import json
import os
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self, TypeVar

import numpy as np
from jaxtyping import jaxtyped
from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, model_validator

from pipeline.files.plain_file import not_plain
from pipeline.files.whole_file import put

ARRAY = "__array__"
"""Key that replaces an array in a record's JSON: {ARRAY: its name among the file's arrays}."""


class StageRecord(BaseModel):
    """A stage's result: numbers, text, arrays, further stage records.

    An array is annotated with its type and shape (jaxtyping); a dimension's name means one length within a
    record. Raises pydantic.ValidationError if a field is missing, unknown, or has another type or shape.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    @model_validator(mode="wrap")
    @classmethod
    def _of_one_shape(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        with jaxtyped("context"):  # compares dimensions of one name within this record
            return handler(value)

    def stored(self) -> tuple[str, dict[str, np.ndarray]]:
        """The record as JSON text and named arrays: what `restored` reads."""
        arrays: dict[str, np.ndarray] = {}
        return json.dumps(_without_arrays(self.model_dump(), "", arrays)), arrays

    @classmethod
    def restored(cls, text: str, arrays: Mapping[str, np.ndarray]) -> Self:
        """The record from the output of `stored`; raises ValueError or ValidationError if it is invalid."""
        try:
            return cls.model_validate(_with_arrays(json.loads(text), arrays))
        except KeyError as missing:
            raise ValueError(f"array {missing} is missing.") from missing


def _without_arrays(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """The value with every array moved into `arrays`, named by its path in the record."""
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {ARRAY: name}
    if isinstance(value, dict):
        under = f"{name}." if name else ""
        return {key: _without_arrays(inner, f"{under}{key}", arrays) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(inner, f"{name}.{k}", arrays) for k, inner in enumerate(value)]
    return value


def _with_arrays(value: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return arrays[value[ARRAY]]
        return {key: _with_arrays(inner, arrays) for key, inner in value.items()}
    if isinstance(value, list):
        return [_with_arrays(inner, arrays) for inner in value]
    return value


PACKAGES = Path(__file__).resolve().parents[2]
"""The folder that contains drupe's packages, two above pipeline/batch/cache.py."""
ROOMS = ("pipeline", "recon", "tactile", "fem", "reports", "samples")
LIBRARIES = (
    "h5py",
    "manifold3d",
    "numpy",
    "onnxruntime",
    "open3d",
    "opencv-python-headless",
    "pi-heif",
    "pillow",
    "pycolmap",
    "pymeshlab",
    "pymetis",
    "pytetwild",
    "pyvista",
    "scipy",
    "trimesh",
    "vtk",
)
HEADER = "__header__"
"""Name of the entry in a stage's file that holds the key and the record as JSON text."""

AT_REST_NS = 3_000_000_000
"""Age of a file's last change after which its times reveal another change: some file systems store whole
seconds, or every second one."""
_hashed: dict[Path, tuple[tuple[int, ...], str]] = {}
"""SHA-256 of files at rest, with the device, inode, size and times of the file then."""
Kept = TypeVar("Kept", bound=StageRecord)


def file_hash(path: Path) -> str:
    """SHA-256 of a file, hexadecimal; for an unreadable file the reason, which its reader reports too.

    A process reads a file only once while its device, inode, size and times stay the same.
    """
    if wrong := not_plain(path):
        return f"unreadable: {wrong}"
    try:
        with path.open("rb") as file:
            state = os.fstat(file.fileno())
            now = (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
            before = _hashed.get(path)
            if before is not None and before[0] == now:
                return before[1]
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            if time.time_ns() - state.st_ctime_ns > AT_REST_NS:
                _hashed[path] = now, digest
            return digest
    except OSError as error:
        return f"unreadable: {error.strerror}"


@cache
def code_version(rooms: tuple[str, ...]) -> str:
    """Hash of the packages' source files (.py, .toml, .csv, without data/) and of the versions of LIBRARIES.

    Raises FileNotFoundError if a package has no source file: the hash would not change with the code.
    """
    digest = hashlib.sha256()
    for room in rooms:
        folder = PACKAGES / room
        files = (path for path in sorted(folder.rglob("*")) if path.suffix in {".py", ".toml", ".csv"})
        code = [path for path in files if "data" not in path.relative_to(folder).parts]
        if not code:
            raise FileNotFoundError(f"{folder}: holds no source files of drupe; install it again.")
        for path in code:
            name = path.relative_to(PACKAGES).as_posix()
            digest.update(name.encode() + b"\0" + path.read_bytes())
    for library, version in library_versions().items():
        digest.update(f"{library} {version}".encode())
    return digest.hexdigest()


@cache
def library_versions() -> Mapping[str, str]:
    """Version of each of LIBRARIES that is installed; cached, because it takes 0.02 s."""
    installed = {}
    for library in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            installed[library] = metadata.version(library)
    return MappingProxyType(installed)


def stage_key(stage: str, *, files: Iterable[Path], settings: Any, rooms: tuple[str, ...]) -> str:
    """The key of a stage: SHA-256 of its input files, its settings and the code of the packages `rooms`."""
    parts = {
        "stage": stage,
        "files": [(path.name, file_hash(path)) for path in files],
        "settings": settings,
        "code": code_version(rooms),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def content_hash(*contents: object) -> str:
    """SHA-256 of arrays, dataclasses and sequences by all their numbers; of anything else by its repr.

    >>> content_hash(np.arange(3), "pad") == content_hash(np.arange(3), "pad") != content_hash(np.arange(4))
    True
    """
    digest = hashlib.sha256()
    for content in contents:
        if isinstance(content, np.ndarray):
            digest.update(f"{content.dtype} {content.shape}".encode())
            digest.update(np.ascontiguousarray(content).tobytes())
        elif isinstance(content, list | tuple):
            digest.update(content_hash(*content).encode())
        elif is_dataclass(content):
            held = (getattr(content, field.name) for field in fields(content))
            digest.update(content_hash(*held).encode())
        else:
            digest.update(repr(content).encode())
        digest.update(b";")
    return digest.hexdigest()


def cached(folder: Path, stage: str, key: str, compute: Callable[[], Kept], *, record: type[Kept]) -> Kept:
    """The record of `stage`: from `folder` if that has the same key, else computed and stored there.

    A damaged file is computed again: it fails its checksums (CRC-32 of the zip format), cannot be read, or
    does not validate as a `record`. Raises NotWritten.
    """
    path = folder / f"{stage}.npz"
    stored = _load(path, key, record)
    if stored is not None:
        return stored
    made = compute()
    text, arrays = made.stored()
    buffer = io.BytesIO()
    named: dict[str, Any] = {HEADER: np.array(json.dumps({"key": key, "record": text})), **arrays}
    np.savez(buffer, **named)
    put(path, buffer.getvalue())
    return made


def _load(path: Path, key: str, record: type[Kept]) -> Kept | None:
    """The stored record; None if no readable record has this key."""
    if not_plain(path):
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            header = json.loads(str(stored[HEADER]))
            if header["key"] != key:
                return None
            arrays = {name: stored[name] for name in stored.files if name != HEADER}
        return record.restored(header["record"], arrays)
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return None
