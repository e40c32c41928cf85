"""A sensor's shading, and its look-up in a file: NumPy's .npz with one array, `coefficients` (k, 2)."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from pipeline.files.plain_file import NotReadable
from tactile.gel.photometric import PhotometricDepth, SlopeLookup, lambert_lookup
from tactile.io.plain_numpy import load_npz
from tactile.sensors import GelCamera, Sensor
from tactile.tactile_failure import TactileFailure, TactileProblem


def shading_of(
    sensor: Sensor, camera: GelCamera, reference: UInt8[np.ndarray, "h w 3"]
) -> PhotometricDepth | None:
    """The depth reader of a photometric sensor, by its look-up or else its lights; None for other kinds."""
    if sensor.kind != "photometric":
        return None
    file = sensor.calibration_file
    lookup = lambert_lookup(sensor.lights, ambient=sensor.ambient) if file is None else read_lookup(file)
    return PhotometricDepth(camera, reference, lookup, gamma=sensor.gamma)


def read_lookup(path: Path) -> SlopeLookup:
    """The look-up in `path`; raises TactileFailure (unreadable-sensor) where it holds none."""
    try:
        coefficients = load_npz(path)["coefficients"]
    except NotReadable as cause:
        raise _refused(path, f"that it {cause}") from cause
    except KeyError as cause:
        raise _refused(path, "no array of coefficients") from cause
    if coefficients.ndim != 2 or coefficients.shape[1] != 2 or not np.isfinite(coefficients).all():
        raise _refused(path, f"coefficients of shape {coefficients.shape}")
    return SlopeLookup(coefficients=coefficients)


def write_lookup(path: Path, lookup: SlopeLookup) -> None:
    """Write `lookup` so that `read_lookup` gives it back; raises TactileFailure where it is not finite."""
    if not np.isfinite(lookup.coefficients).all():
        raise _refused(path, "coefficients that are not finite")
    with path.open("wb") as file:
        np.savez(file, coefficients=lookup.coefficients)


def _refused(path: Path, fault: str) -> TactileFailure:
    return TactileFailure(
        TactileProblem.UNREADABLE_SENSOR,
        f"{path.name}: found {fault}, expected a photometric look-up as drupe calibrate writes it.",
    )
