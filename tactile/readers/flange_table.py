"""A table of a robot's flange poses, as its controller or driver logs them: base_from_flange, one per row.

The first row names the columns. Positions are `x_mm`, `y_mm`, `z_mm` or `x_m`, `y_m`, `z_m`. Rotations are a
quaternion `qx`, `qy`, `qz`, `qw`, a rotation vector `rx_rad`, `ry_rad`, `rz_rad` (or `_deg`), or a matrix
`r11`, `r12` ... `r33`. They may also be angles `roll_deg`, `pitch_deg`, `yaw_deg` (or `_rad`) about the fixed
axes x, y, z in this order. Optional are `time_s`, `aperture_mm`, and the `photo` that was taken there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from tactile.readers.cell_rows import Row, cells_of, numbers_in, refuse_repeated_names, sheets_of
from tactile.readers.grasp_log import increasing
from tactile.readers.pictures import unusable

PLACE = {("x_mm", "y_mm", "z_mm"): 1.0, ("x_m", "y_m", "z_m"): 1000.0}
"""Columns of the position, and the factor to mm."""
QUATERNION = ("qx", "qy", "qz", "qw")
VECTOR = {("rx_rad", "ry_rad", "rz_rad"): 1.0, ("rx_deg", "ry_deg", "rz_deg"): np.pi / 180}
"""Columns of the rotation vector, and the factor to radians."""
ANGLES = {("roll_rad", "pitch_rad", "yaw_rad"): 1.0, ("roll_deg", "pitch_deg", "yaw_deg"): np.pi / 180}
"""Columns of Euler angles, and the factor to radians: R = Rz(yaw) Ry(pitch) Rx(roll). ROS (REP 103) and URDF
have this convention; FANUC names them W, P, R and KUKA C, B, A."""
MATRIX = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
ROTATIONS = (QUATERNION, *VECTOR, *ANGLES, MATRIX)
LEAST_REACH_MM, MOST_REACH_MM = 20.0, 20_000.0
"""These are the limits of the farthest flange position, mm: no arm works within 20 mm of its base, and none
reaches 20 m. Beyond them the unit is another."""
MOST_TURN_RAD = 2 * np.pi + 1e-3
"""Length of a rotation vector in radians; a longer one is in degrees."""
NOT_ROTATION = 2e-3
"""Deviation of a quaternion's length from 1, or of R'R from the identity: three decimals round to 1e-3."""
MOST_ROWS = 1_000_000
"""Of a table: 15 minutes at 1 kHz."""


@dataclass(frozen=True, kw_only=True)
class FlangeTable:
    """`base_from_flange` (mm), NaN in rows without a pose. `photo`: names of files. `row`: numbers of the
    rows in the file. A column that the table lacks is None.
    """

    base_from_flange: Float[np.ndarray, "n 4 4"]
    row: tuple[int, ...]
    time_s: Float[np.ndarray, " n"] | None
    aperture_mm: Float[np.ndarray, " n"] | None
    photo: tuple[str, ...] | None

    @property
    def known(self) -> Bool[np.ndarray, " n"]:
        """Whether the row has a pose."""
        return np.asarray(np.isfinite(self.base_from_flange[:, 0, 0]))


def read_flange_table(path: Path) -> FlangeTable:
    """The table in a .csv, .txt, .tsv, .xls or .xlsx; raises TactileFailure that names row and column.

    A row may lack the whole pose (a photo of the mat at its place before a camera at rest).
    """
    header, *rows = sheets_of(path)[0].rows or ((1, []),)
    names = [str(cell) for cell in header[1]]
    refuse_repeated_names(path.name, names)
    if not 0 < len(rows) <= MOST_ROWS:
        raise unusable(path.name, f"{len(rows)} rows of poses", f"1 to {MOST_ROWS}")
    place = next((columns for columns in PLACE if set(columns) <= set(names)), None)
    turn = next((columns for columns in ROTATIONS if set(columns) <= set(names)), None)
    if place is None or turn is None:
        lacking = (
            "x_mm, y_mm, z_mm or x_m, y_m, z_m" if place is None else " or ".join(map(", ".join, ROTATIONS))
        )
        observed = "the columns " + (", ".join(names)[:150] or "of an empty row")
        raise unusable(path.name, observed, f"columns {lacking}, with the unit in the name")

    def numbers(columns: Sequence[str], *, holes: bool = False) -> Float[np.ndarray, "n k"]:
        cells = [(f"{path.name}: {name}", names.index(name)) for name in columns]
        return np.stack([numbers_in(*column, rows, holes=holes, commas=True) for column in cells], axis=1)

    shift = numbers(place, holes=True) * PLACE[place]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = shift
    poses[:, :3, :3] = _rotations(path.name, rows, turn, numbers(turn, holes=True))
    partly = np.isfinite(poses[:, :3]).any(axis=(1, 2)) & ~np.isfinite(poses[:, :3]).all(axis=(1, 2))
    if partly.any():
        raise unusable(
            f"{path.name}: row {rows[int(np.argmax(partly))][0]}", "part of a pose", "all or none of it"
        )
    farthest = float(np.nanmax(np.linalg.norm(shift, axis=1), initial=0.0))
    if np.isfinite(shift).any() and not LEAST_REACH_MM < farthest < MOST_REACH_MM:
        observed = f"positions at most {farthest:.3g} mm from the base"
        expected = f"{LEAST_REACH_MM:g} to {MOST_REACH_MM:g} mm; is {place[0]} in another unit?"
        raise unusable(path.name, observed, expected)
    time_s = numbers(("time_s",))[:, 0] if "time_s" in names else None
    if time_s is not None:
        increasing(path.name, time_s)
    return FlangeTable(
        base_from_flange=poses,
        row=tuple(number for number, _ in rows),
        time_s=time_s,
        aperture_mm=numbers(("aperture_mm",))[:, 0] if "aperture_mm" in names else None,
        photo=tuple(str(cell).strip() for (cell,) in cells_of(rows, [names.index("photo")]))
        if "photo" in names
        else None,
    )


def _rotations(
    source: str, rows: Sequence[Row], notation: tuple[str, ...], values: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n 3 3"]:
    """The rotations, NaN for empty cells; raises TactileFailure, with the row, for a wrong one."""
    known = np.isfinite(values).all(axis=1)
    given = values[known]

    def refuse(wrong: np.ndarray, observed: str) -> None:
        if (wrong > NOT_ROTATION).any():
            row = rows[int(np.flatnonzero(known)[np.argmax(wrong > NOT_ROTATION)])][0]
            raise unusable(f"{source}: row {row}", observed, "a right-handed rotation")

    turns = np.full((len(values), 3, 3), np.nan)
    if notation == QUATERNION:
        refuse(np.abs(np.linalg.norm(given, axis=1) - 1), "a quaternion of another length than 1")
        turns[known] = Rotation.from_quat(given).as_matrix() if known.any() else given.reshape(-1, 3, 3)
    elif notation == MATRIX:
        matrices = given.reshape(-1, 3, 3)
        square = np.swapaxes(matrices, 1, 2) @ matrices
        refuse(np.abs(square - np.eye(3)).max(axis=(1, 2)), "a matrix that is no rotation")
        refuse(np.linalg.det(matrices) < 0, "a left-handed matrix (determinant -1)")
        left, _, right = np.linalg.svd(matrices)
        turns[known] = left @ right
    else:
        factor = next(k for names, k in (*VECTOR.items(), *ANGLES.items()) if names == notation)
        size = np.linalg.norm(given, axis=1) if notation in VECTOR else np.abs(given).max(axis=1)
        refuse((size > MOST_TURN_RAD) & (factor == 1.0), "a turn of more than 2 pi; is it in degrees")
        turn = Rotation.from_rotvec(given * factor)
        if notation in ANGLES:
            turn = Rotation.from_euler("xyz", given * factor)
        turns[known] = turn.as_matrix()
    return turns
