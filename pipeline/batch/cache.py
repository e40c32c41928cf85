"""Stage results, kept under the hash of what they came from: a second run does only what changed."""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.files.whole_file import put
from recon.plain_file import not_plain

PACKAGES = Path(__file__).resolve().parents[2]
"""The folder in which the rooms lie: pipeline/batch/cache.py is two below it."""
ROOMS = ("pipeline", "recon", "tactile", "fem", "reports", "samples")
LIBRARIES = (
    "h5py",
    "manifold3d",
    "numpy",
    "onnxruntime",
    "open3d",
    "opencv-python-headless",
    "pi-heif",
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


@dataclass(frozen=True)
class Artifact:
    """What a stage hands on: named arrays, and facts that JSON can hold."""

    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


def file_hash(path: Path) -> str:
    """SHA-256 of a file, hexadecimal; of a file that cannot be read, why (its reader will say so too)."""
    if wrong := not_plain(path):
        return f"unreadable: {wrong}"
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return f"unreadable: {error.strerror}"


@cache
def code_version(rooms: tuple[str, ...]) -> str:
    """A hash of the source files of these rooms and of the numerical libraries' versions.

    Raises FileNotFoundError where a room has none: results would be kept whatever the code became.
    """
    digest = hashlib.sha256()
    for room in rooms:
        folder = PACKAGES / room
        files = {path.relative_to(folder): path for path in sorted(folder.rglob("*"))}
        code = {
            name: path
            for name, path in files.items()
            if path.suffix in {".py", ".toml", ".csv"} and "data" not in name.parts
        }
        if not code:
            raise FileNotFoundError(f"{folder}: holds no source files of drupe; install it again.")
        for name, path in code.items():
            digest.update(f"{room}/{name.as_posix()}".encode() + b"\0" + path.read_bytes())
    for library in LIBRARIES:
        digest.update(f"{library} {metadata.version(library)}".encode())
    return digest.hexdigest()


def stage_key(stage: str, *, files: Iterable[Path], settings: Any, rooms: tuple[str, ...]) -> str:
    """The key of a stage: hash of its inputs' contents, its settings and its code."""
    parts = {
        "stage": stage,
        "files": [(path.name, file_hash(path)) for path in files],
        "settings": settings,
        "code": code_version(rooms),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def cached(folder: Path, stage: str, key: str, compute: Callable[[], Artifact]) -> Artifact:
    """The artifact of `stage`, from `folder` if it was made from the same key, else computed and kept."""
    path = folder / f"{stage}.npz"
    stored = _load(path, key)
    if stored is not None:
        return stored
    artifact = compute()
    buffer = io.BytesIO()
    header = json.dumps({"key": key, "facts": artifact.facts})
    named: dict[str, Any] = {HEADER: np.array(header), **artifact.arrays}
    np.savez(buffer, **named)
    put(path, buffer.getvalue())
    return artifact


def _load(path: Path, key: str) -> Artifact | None:
    """The stored artifact, or None where there is none of this key (a damaged file, or what is no file and
    could be waited for, counts as none).
    """
    if not_plain(path):
        return None
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
            header = json.loads(str(stored[HEADER]))
            if header["key"] != key:
                return None
            arrays = {name: stored[name] for name in stored.files if name != HEADER}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    return Artifact(arrays=arrays, facts=header["facts"])
