"""Which picture of the untouched gel a pad's frames are held against, as grasp.toml names it.

`reference` is a picture, or another clip of the same gel (a folder of frame_*.png or a video), beside the
grasp or elsewhere in its batch; `reference_frames = [k, m]` are frames k to m - 1 of that clip or, without
one, of the pad's own.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from tactile.readers.pictures import PICTURES, VIDEOS, Pictures, pictures_in, read_picture, unusable
from tactile.readers.toml_table import Table

BATCH = "batch.toml"
"""In the folder that nothing named in a grasp may lead out of."""
FOLDERS_ABOVE = 4
"""Of a grasp, among which the batch's is: fruits, the fruit's, grasps, and one to spare."""
MOST_FRAMES = 1000
"""Of a mean: noise falls by thirty with them, and the frames of a longer clip need not be read."""
ADVICE = (
    "a picture of the untouched gel; or name another clip or picture of it (reference = ...), or frames of "
    "it (reference_frames = [0, 5])"
)


@dataclass(frozen=True)
class Reference:
    """The picture, and the file or the frames that it comes from."""

    picture: UInt8[np.ndarray, "h w 3"]
    source: str


def read_reference(folder: Path, pad: str, table: Table, pictures: Pictures) -> Reference:
    """The reference of a pad; `table` is the pad's in grasp.toml, `pictures` are its own frames.

    Raises TactileFailure (unreadable-frames) that names the file and the field: a path that leads out of the
    batch, what is not there, frames that the clip does not have, or two references.
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
    """Where grasp.toml's `reference` is; raises TactileFailure where that is outside the batch."""
    root = batch_of(folder)
    if Path(said).is_absolute() or not (folder / said).resolve().is_relative_to(root):
        expected = (
            f"a file or folder inside the batch ({root.name}), named relative to {folder.name}: copy it there"
        )
        raise table.refusal("reference", f"{said}, which leads out of the batch", expected)
    return folder / said


def batch_of(folder: Path) -> Path:
    """The folder above that holds batch.toml; without one, the folder that the grasp lies in."""
    here = folder.resolve()
    above = (here, *here.parents[:FOLDERS_ABOVE])
    return next((place for place in above if (place / BATCH).is_file()), here.parent)


def reference_path(place: Path) -> Path:
    """The picture called reference in a folder of frames; reference.png where there is none."""
    return next((p for s in PICTURES if (p := place / f"reference{s}").is_file()), place / "reference.png")


def _mean(table: Table, pictures: Pictures) -> Reference:
    """The mean of the clip's frames that reference_frames names; of all without it."""
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
