"""Displacement and force per marker from tables: NumPy's .npz, a CSV file, or topics of a ROS 2 bag.

The .npz has the names of a recording: `time_s` (T,) and `aperture_mm` (T,). Each pad (left and right, or tip)
has `pads/<pad>/rest_mm` (N, 3), `pads/<pad>/displacement_mm` and `pads/<pad>/force_N` (T, N, 3). A
`pads/<pad>/pose` (T, 4, 4) or (4, 4) is optional. Instead of these, the .npz may have one array for all pads
with the pad as its first axis: `rest_mm` (2, N, 3) and so on, as `drupe.recording` takes them.

The CSV file has one row for each frame and marker: `time_s`, `aperture_mm`, `pad` (0 left or tip, 1 right),
`marker`, `x_mm`, `y_mm`, `z_mm` (at rest), `dx_mm`, `dy_mm`, `dz_mm`, `fx_N`, `fy_N`, `fz_N`.
"""

from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float

from pipeline.files.plain_file import NotReadable
from tactile.readers.grasp_log import increasing, read_columns
from tactile.readers.pictures import unusable
from tactile.readers.plain_numpy import array_fault, load_npz
from tactile.readers.recording import Converted, GelPad, Loading, Recording
from tactile.readers.recording_fields import Shape
from tactile.readers.ros_bag import bag_fields
from tactile.sensors import Sensor, gel_constants

REST, MOVED, PUSHED = ("x_mm", "y_mm", "z_mm"), ("dx_mm", "dy_mm", "dz_mm"), ("fx_N", "fy_N", "fz_N")
OF_A_PAD = ("rest_mm", "displacement_mm", "force_N", "pose")
PADS = {1: ("tip",), 2: ("left", "right")}
"""Names of the pads by their number: a press has 1, a grasp 2."""
COLUMNS = ("time_s", "aperture_mm", "pad", "marker", *REST, *MOVED, *PUSHED)


def read_field_table(
    path: Path, *, fruit_id: str, category: str, sensor: Sensor, topics: Path | None = None
) -> Converted:
    """A recording from a table of marker fields. `sensor`: with the gel's stiffness; `topics`: those of a
    bag.

    Raises TactileFailure (unreadable-frames) that names the file, the field and its fault.
    """
    if topics is not None:
        held = bag_fields(path, topics)
    else:
        held = _npz(path) if path.suffix.lower() == ".npz" else _from_csv(path)
    names = ("left", "right") if "pads/left/rest_mm" in held else ("tip",)
    time_s = _field(path, held, "time_s", (None,))
    frames = len(time_s)
    increasing(path.name, time_s)
    of_gel = gel_constants(sensor)
    notes = []
    pads = []
    for name in names:
        rest = _field(path, held, f"pads/{name}/rest_mm", (None, 3))
        shape = (frames, len(rest), 3)
        pose = held.get(f"pads/{name}/pose")
        if pose is None:
            notes.append(f"{path.name}: no pads/{name}/pose; drupe writes no motion.")
            pose = np.eye(4)
        if pose.ndim == 2:
            pose = np.broadcast_to(pose, (frames, 4, 4)).copy()
        pads.append(
            GelPad(
                name=name,
                pose=_checked(path, f"pads/{name}/pose", pose, (frames, 4, 4)),
                rest_mm=rest,
                displacement_mm=_field(path, held, f"pads/{name}/displacement_mm", shape),
                force_N=_field(path, held, f"pads/{name}/force_N", shape),
                **of_gel,
            )
        )
    loading = "press" if names == ("tip",) else "grasp"
    recording = Recording(
        fruit_id=fruit_id,
        category=category,
        loading=cast(Loading, loading),
        support="base" if loading == "press" else "free",
        sensor=sensor.name,
        time_s=time_s,
        aperture_mm=_field(path, held, "aperture_mm", (frames,)),
        pads=tuple(pads),
    )
    return Converted(recording=recording, notes=tuple(notes))


def _npz(path: Path) -> dict[str, np.ndarray]:
    try:
        return _by_pad(path, load_npz(path))
    except NotReadable as cause:
        raise unusable(path.name, f"that it {cause}", "a whole .npz of numbers; copy it again") from cause


def _by_pad(path: Path, held: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays with a name per pad; unchanged if they have it. Raises TactileFailure for another number of
    pads.
    """
    stacked = [name for name in OF_A_PAD if name in held]
    for field in stacked:
        where, shape = f"{path.name}: {field}", f"shape {held[field].shape}"
        names = PADS.get(len(held[field]) if held[field].ndim else 0)
        if names is None:
            raise unusable(where, shape, "2 pads or 1 as its first axis")
        if len(names) != len(held[stacked[0]]):
            raise unusable(where, shape, f"as many pads as {stacked[0]}, {len(held[stacked[0]])}")
        held |= {f"pads/{name}/{field}": values for name, values in zip(names, held[field], strict=True)}
    return held


def _from_csv(path: Path) -> dict[str, np.ndarray]:
    """The columns as arrays by frame and marker. Raises TactileFailure for a missing column or row."""
    columns = read_columns(path, wanted=COLUMNS)
    time_s, first = np.unique(columns["time_s"], return_index=True)
    held = {"time_s": time_s, "aperture_mm": columns["aperture_mm"][first]}
    kinds = np.unique(columns["pad"])
    names = {0.0: "left", 1.0: "right"} if len(kinds) == 2 else {float(kinds[0]): "tip"}
    for number, name in names.items():
        rows = np.flatnonzero(columns["pad"] == number)
        order = rows[np.lexsort([columns["marker"][rows], columns["time_s"][rows]])]
        count = len(np.unique(columns["marker"][rows]))
        if len(order) != count * len(time_s):
            fault = f"{len(order)} rows of pad {number:g}"
            raise unusable(path.name, fault, f"{count} markers in each of {len(time_s)} frames")
        for field, triple in (("rest_mm", REST), ("displacement_mm", MOVED), ("force_N", PUSHED)):
            values = np.stack([columns[c][order] for c in triple], axis=1).reshape(len(time_s), count, 3)
            held[f"pads/{name}/{field}"] = values[0] if field == "rest_mm" else values
    return held


def _field(path: Path, held: dict[str, np.ndarray], name: str, shape: Shape) -> Float[np.ndarray, "..."]:
    if name not in held:
        raise unusable(f"{path.name}: {name}", "no such array", "it beside " + ", ".join(sorted(held)))
    return _checked(path, name, held[name], shape)


def _checked(path: Path, name: str, values: np.ndarray, shape: Shape) -> np.ndarray:
    if fault := array_fault(values, shape):
        raise unusable(f"{path.name}: {name}", *fault)
    return values
