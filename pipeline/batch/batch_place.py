"""Whether a place can be a batch's folder. It imports little: a wrong path is refused within a second."""

import os
from pathlib import Path

from pipeline.problem import BatchRefused, nearest, refused


def require_folder(root: Path) -> None:
    """Raises BatchRefused where the batch's folder is not there, is no folder, or is that of one fruit."""
    if root.exists() and not root.is_dir():
        raise refused(root, "is a file; give the batch folder.")
    if (batch := batch_around(root)) is not None:
        raise refused(root, f"is the folder of one fruit; give the batch, {batch}.")
    if not root.is_dir():
        raise not_there(root, holding="batch.toml", otherwise="give an existing batch folder.")


def not_there(root: Path, *, holding: str, otherwise: str) -> BatchRefused:
    """That a folder does not exist, and which one beside it with the file `holding` was likely meant."""
    names = [folder.name for folder in root.parent.glob("*/") if (folder / holding).is_file()]
    return refused(root, f"does not exist; {nearest(root.name, names, otherwise)}")


def batch_around(fruit: Path) -> Path | None:
    """The batch in which a folder is that of one fruit; None where it is not."""
    place = Path(os.path.realpath(fruit))  # a loop of links has a real path, and is no folder
    if not place.is_dir() or place.parent.name.lower() != "fruits" or (place / "batch.toml").is_file():
        return None
    return place.parents[1] if (place.parents[1] / "batch.toml").is_file() else None
