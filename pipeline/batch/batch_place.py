"""Checks whether a path can be a batch folder. It imports little, to refuse a wrong path within a second."""

import os
from pathlib import Path

from pipeline.problem import BatchRefused, nearest, refused


def require_folder(root: Path) -> None:
    """Raises BatchRefused if the batch folder does not exist, is a file, or is the folder of one fruit."""
    if root.exists() and not root.is_dir():
        raise refused(root, "is a file; give the batch folder.")
    if (batch := batch_around(root)) is not None:
        raise refused(root, f"is the folder of one fruit; give the batch, {batch}.")
    if not root.is_dir():
        raise not_there(root, holding="batch.toml", otherwise="give an existing batch folder.")


def not_there(root: Path, *, holding: str, otherwise: str) -> BatchRefused:
    """The refusal of a missing folder; suggests a sibling of similar name that has the file `holding`."""
    names = [folder.name for folder in root.parent.glob("*/") if (folder / holding).is_file()]
    return refused(root, f"does not exist; {nearest(root.name, names, otherwise)}")


def batch_around(fruit: Path) -> Path | None:
    """The batch to which a fruit's folder belongs; None if the folder is not one of a fruit."""
    place = Path(os.path.realpath(fruit))  # Path.resolve may raise for a loop of links
    if not place.is_dir() or place.parent.name.lower() != "fruits" or (place / "batch.toml").is_file():
        return None
    return place.parents[1] if (place.parents[1] / "batch.toml").is_file() else None
