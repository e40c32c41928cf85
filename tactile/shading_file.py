"""A photometric look-up in a file: NumPy's .npz with one array, `coefficients` (k, 2)."""

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from tactile.failure import TactileFailure, TactileProblem
from tactile.photometric import SlopeLookup


def read_lookup(path: Path) -> SlopeLookup:
    """The look-up in `path`; raises TactileFailure (unreadable-sensor) where it holds none."""
    try:
        with np.load(path, allow_pickle=False) as file:
            coefficients = np.asarray(file["coefficients"], dtype=np.float64)
    except (OSError, KeyError, ValueError, BadZipFile) as cause:
        raise _refused(path, str(cause)) from cause
    if coefficients.ndim != 2 or coefficients.shape[1] != 2 or not np.isfinite(coefficients).all():
        raise _refused(path, f"coefficients of shape {coefficients.shape}")
    return SlopeLookup(coefficients=coefficients)


def write_lookup(path: Path, lookup: SlopeLookup) -> None:
    """Write `lookup` so that `read_lookup` gives it back."""
    with path.open("wb") as file:
        np.savez(file, coefficients=lookup.coefficients)


def _refused(path: Path, found: str) -> TactileFailure:
    return TactileFailure(
        TactileProblem.UNREADABLE_SENSOR,
        f"{path.name}: found {found}, expected a photometric look-up as drupe calibrate writes it.",
    )
