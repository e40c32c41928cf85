"""A raw grasp inside one HDF5 file: a recording with `images` in place of displacement and force."""

from pathlib import Path
from typing import Any, cast

from tactile.io.hdf5_file import opened
from tactile.io.pictures import pictures_of
from tactile.io.raw_grasp import RawCamera, RawGrasp, RawPad
from tactile.io.recording import (
    APERTURE,
    FORMAT,
    PADS_OF_LOADING,
    TIME,
    VERSION,
    WRENCH,
    Loading,
    Support,
)
from tactile.io.recording_fields import GroupReader
from tactile.io.sensor_file import read_sensor
from tactile.tactile_failure import TactileFailure, TactileProblem


def holds_images_only(path: Path) -> bool:
    """Whether the file's pads have images and no displacement."""
    with opened(path) as file:
        root = GroupReader(path=path, group=file)
        if "pads" not in root or not hasattr(file["pads"], "keys"):
            return False
        pads = root.child("pads")
        names = [name for name in ("left", "right", "tip") if name in pads]
        groups = [pads.child(name) for name in names if hasattr(file["pads"][name], "keys")]
        return bool(groups) and all("images" in g and "displacement_mm" not in g for g in groups)


def raw_of(file: Any, path: Path, *, sensor: Path) -> RawGrasp:
    """The raw grasp in an open file; its frames are read one at a time while the file stays open.

    Raises TactileFailure: unreadable-recording that names the field, unreadable-sensor, or unreadable-frames
    where a pad has no reference.
    """
    root = GroupReader(path=path, group=file)
    root.choice("format", {FORMAT})
    root.version("version", VERSION)
    loading = cast(Loading, root.choice("loading", set(PADS_OF_LOADING)))
    time_s = root.time("time_s", limit=TIME)
    frames = len(time_s)
    pads = []
    for name in PADS_OF_LOADING[loading]:
        pad = root.child("pads").child(name)
        if "images_reference" not in pad:
            raise TactileFailure(
                TactileProblem.UNREADABLE_FRAMES,
                f"{path.name}: pads/{name}/images_reference: found nothing, expected a picture of the "
                "untouched gel.",
            )
        data = pad.images("images", frames)
        pads.append(
            RawPad(
                name=name,
                sensor=read_sensor(sensor),
                view=RawCamera(
                    reference=pad.picture("images_reference"),
                    pictures=pictures_of(data, f"{path.name}: pads/{name}/images"),
                ),
                second=None,
                time_s=time_s,
                pose=pad.poses("pose", frames),
            )
        )
    default = "free" if loading == "grasp" else "base"
    return RawGrasp(
        source=path.name,
        fruit_id=root.text("fruit_id"),
        category=root.text("category"),
        loading=loading,
        support=cast(Support, root.choice("support", {"free", "base"}, default=default)),
        aperture_mm=root.array("aperture_mm", (frames,), limit=APERTURE),
        wrench_N=root.array("wrench_N", (frames, 6), limit=WRENCH) if "wrench_N" in root else None,
        pads=tuple(pads),
    )
