"""A bare indenter's trace: time, travel and force in a CSV file."""

from pathlib import Path
from typing import Literal

import numpy as np

from tactile.io.converted import Converted
from tactile.io.field_tables import MOVED
from tactile.io.grasp_log import increasing, read_columns
from tactile.io.named_file import not_plain
from tactile.io.pictures import unusable
from tactile.io.recording import IndenterPad, Recording

TRAVEL = ("travel_mm", "aperture_mm")
FORCE = ("force_N", "force_z_N", "fz_N")
"""Names that travel and force may have; the first that the file has is taken."""
OF_MARKERS = frozenset({"pad", "marker", *MOVED})
"""Columns that a table of marker fields has and no load cell: a file with one of them is such a table, if an
incomplete one, whose reader then names the column that is missing. A place alone (`z_mm`) may be a machine's.
"""


def is_trace(path: Path) -> bool:
    """Whether the file's header is that of a bare load cell: a force, and no column of markers."""
    names = header_of(path)
    return OF_MARKERS.isdisjoint(names) and any(name in names for name in FORCE)


def header_of(path: Path) -> list[str]:
    """The names in a CSV file's first row."""
    if not_plain(path):
        return []
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return [name.strip() for name in file.readline(10_000).split(",")]


def read_trace(
    path: Path, *, fruit_id: str, category: str, indenter: Literal["ball", "flat", "plate"], radius_mm: float
) -> Converted:
    """`time_s`, `travel_mm` and `force_N` of a press, positive when pressed; the pose is not known.

    Raises TactileFailure (unreadable-frames) for a missing column, a cell that is no number, or time that
    runs back.
    """
    columns = read_columns(path, wanted=("time_s", TRAVEL[0], FORCE[0]))
    travel = next((name for name in TRAVEL if name in columns), None)
    force = next((name for name in FORCE if name in columns), None)
    if "time_s" not in columns or travel is None or force is None:
        found = "the columns " + ", ".join(columns)
        raise unusable(path.name, found, "time_s, travel_mm and force_N")
    increasing(path.name, columns["time_s"])
    pushed = columns[force]
    notes = ["no pose: written as no motion."]
    if -pushed.min() > pushed.max():
        notes.append(f"{path.name}: the force is negative when pressed; its sign is turned.")
        pushed = -pushed
    frames = len(pushed)
    pad = IndenterPad(
        name="tip",
        pose=np.broadcast_to(np.eye(4), (frames, 4, 4)).copy(),
        force_z_N=pushed,
        indenter=indenter,
        radius_mm=radius_mm,
    )
    recording = Recording(
        fruit_id=fruit_id,
        category=category,
        loading="press",
        support="base",
        sensor="load cell",
        time_s=columns["time_s"],
        aperture_mm=columns[travel],
        pads=(pad,),
    )
    return Converted(recording=recording, notes=tuple(notes))
