"""The picture of the untouched gel to which a pad's frames are compared, as grasp.toml names it.

`reference` is a picture, or another clip of the same gel (a folder of frame_*.png or a video). It lies in the
grasp or elsewhere in its batch. `reference_frames = [k, m]` are frames k to m - 1 of that clip, or without
one of the pad's own; the reference is their mean.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from tactile.readers.pictures import PICTURES, VIDEOS, Pictures, pictures_in, read_picture, unusable
from tactile.readers.toml_table import Table

BATCH = "batch.toml"
"""File of the batch's folder, which paths in a grasp must not leave."""
FOLDERS_ABOVE = 4
"""Folders above a grasp in which files are sought: grasps, the fruit's, fruits and the batch's."""
MOST_FRAMES = 1000
"""Most frames of a mean without `reference_frames`: its noise is a thirtieth of one frame's."""
ADVICE = (
    "a picture of the untouched gel; or name another clip or picture of it (reference = ...), or frames of "
    "it (reference_frames = [0, 5])"
)


@dataclass(frozen=True)
class Reference:
    """The picture, and the name of the file or frames that it comes from."""

    picture: UInt8[np.ndarray, "h w 3"]
    source: str


def read_reference(folder: Path, pad: str, table: Table, pictures: Pictures) -> Reference:
    """The reference of a pad; `table` is the pad's in grasp.toml, `pictures` are its own frames.

    Raises TactileFailure (unreadable-frames), with file and field, for a path out of the batch, a missing
    file, frames that the clip lacks, or two references.
    """
    said = table.file_name("reference", default="")
    chosen = "reference_frames" in table.values
    if not said and not chosen:
        path = reference_path(folder / pad)
        if not path.is_file():
            raise unusable(f"{pad}/reference.png", "no such file", ADVICE)
        return Reference(read_picture(path), path.name)
    if not said:
        return _mean(table, pictures)
    path = named_reference(folder, table, said)
    if path.is_dir() or path.suffix.lower() in VIDEOS:
        return _mean(table, pictures_in(path))
    if chosen:
        expected = "a clip (a folder of frames or a video) to take frames from, or no reference_frames"
        raise table.refusal("reference", f"the picture {said} beside reference_frames", expected)
    if not path.is_file():
        raise unusable(f"{pad}: reference = {said}", "no such file", ADVICE)
    return Reference(read_picture(path), path.name)


def named_reference(folder: Path, table: Table, said: str) -> Path:
    """The path of grasp.toml's `reference`; raises TactileFailure if it is outside the batch."""
    root = batch_of(folder)
    if Path(said).is_absolute() or not (folder / said).resolve().is_relative_to(root):
        expected = (
            f"a file or folder inside the batch ({root.name}), named relative to {folder.name}: copy it there"
        )
        raise table.refusal("reference", f"{said}, which leads out of the batch", expected)
    return folder / said


def batch_of(folder: Path) -> Path:
    """The nearest folder above with batch.toml; without one, the folder that contains the grasp."""
    here = folder.resolve()
    above = (here, *here.parents[:FOLDERS_ABOVE])
    return next((place for place in above if (place / BATCH).is_file()), here.parent)


def reference_path(place: Path) -> Path:
    """The picture named reference in a folder of frames; reference.png if there is none."""
    return next((p for s in PICTURES if (p := place / f"reference{s}").is_file()), place / "reference.png")


def _mean(table: Table, pictures: Pictures) -> Reference:
    """The mean of the clip's frames in reference_frames; without that key, of the first MOST_FRAMES."""
    count = len(pictures.numbers)
    first, end = 0, min(count, MOST_FRAMES)
    if "reference_frames" in table.values:
        first, end = (int(k) for k in table.numbers("reference_frames", (2,)).tolist())
        if not 0 <= first < end <= count:
            fault = f"[{first}, {end}] of {count} frames"
            raise table.refusal("reference_frames", fault, "first frame and the one after the last")
    total: np.ndarray | None = None
    for k, frame in zip(range(end), pictures.frames(), strict=False):
        if k < first:
            continue
        if total is not None and total.shape != frame.shape:
            fault = f"frame {pictures.numbers[k]} of {frame.shape[1]} x {frame.shape[0]} pixels"
            raise unusable(pictures.source, fault, f"{total.shape[1]} x {total.shape[0]} as those before")
        total = frame.astype(np.float64) if total is None else total + frame
    if total is None:
        raise unusable(pictures.source, "no frames", "frames of the untouched gel")
    mean = np.asarray(np.rint(total / (end - first)), dtype=np.uint8)
    return Reference(mean, f"frames {first} to {end - 1} of {pictures.source}")
