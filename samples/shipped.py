"""Batches in the package, ready to copy without renderer or simulation."""

import shutil
from pathlib import Path

from samples.sample_failure import SampleFailure

_DATA = Path(__file__).parent / "data"


def shipped_batches() -> tuple[str, ...]:
    """Names of the shipped batches in alphabetical order."""
    names = sorted(p.parent.name for p in _DATA.glob("*/batch.toml"))
    return tuple(names)


def write_shipped(name: str, folder: Path) -> None:
    """Copy a shipped batch into `folder`, which must not exist yet or be empty.

    Raises SampleFailure for an unknown name or a folder in use.
    """
    if name not in shipped_batches():
        known = ", ".join(shipped_batches()) or "none"
        raise SampleFailure(f"There is no shipped batch {name!r}; there are: {known}.")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SampleFailure(f"{folder} exists and is not an empty folder; name a new one.")
    shutil.copytree(_DATA / name, folder, dirs_exist_ok=True)
