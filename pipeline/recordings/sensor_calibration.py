"""`drupe calibrate`: corrects a sensor's description by a press on a load cell."""

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.batch.scratch import scratch
from pipeline.files.plain_file import NotReadable, read_text, toml_of
from pipeline.files.toml_text import as_toml
from pipeline.problem import refused
from pipeline.recordings.description_file import MOST_BYTES, DescriptionKind, frame_progress
from tactile.from_frames import recording_of
from tactile.gel.press_modulus import gel_gain
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import GelPad
from tactile.readers.sensor_file import read_sensor

LEAST_KNOWN_TO = 1e-3
"""Least relative standard deviation of a force's scale after a press (set by hand)."""
CALIBRATED = DescriptionKind("# written by drupe calibrate", "a description that drupe calibrate wrote")


def calibrate(
    sensor: Path, out: Path, load_cell: Path | None, *, today: datetime.date, report: Callable[[str], None]
) -> tuple[str, ...]:
    """Writes `sensor` to `out` with the gel's E_MPa from the press, and returns a summary in sentences.

    Raises TactileFailure for an unusable press. Raises BatchRefused without a press or its load cell, for an
    unreadable `sensor`, or if `out` is an input or not a file of drupe calibrate.
    """
    if load_cell is None:
        what = (
            "there is nothing to calibrate with. For a sensor give --load-cell. For a rig give --rigid and "
            "--size-mm."
        )
        raise refused(sensor, what)
    described = _described(sensor)
    described["calibrated_on"] = today.isoformat()
    folders = [load_cell] if load_cell.is_dir() else []
    CALIBRATED.require_place(out, inputs=[sensor, load_cell], folders=folders)
    with scratch() as folder:
        stage = folder / out.name
        stage.write_text(as_toml(described), encoding="utf-8")
        said = _stiffness(stage, described, load_cell, report)
    CALIBRATED.put(out, described, read_sensor)
    dated = (
        f"dated {today}: write calibrated_on = {today} under [sensor] in batch.toml, where calibration_days "
        "limits its age"
    )
    return said, dated


def _described(sensor: Path) -> dict[str, Any]:
    if not sensor.is_file():
        raise refused(sensor, "does not exist; give the sensor's description.")
    try:
        return toml_of(read_text(sensor, most_bytes=MOST_BYTES))
    except NotReadable as cause:
        raise refused(sensor, f"{cause}; correct the description.") from cause


def _stiffness(path: Path, described: dict[str, Any], press: Path, report: Callable[[str], None]) -> str:
    """Scales the gel's E_MPa in `described` to the load cell's force, in place; returns a sentence on it."""
    recording = recording_of(read_raw_grasp(press, sensor=path), progress=frame_progress(report)).recording
    pad = recording.pads[0]
    if recording.wrench_N is None or not isinstance(pad, GelPad):
        raise refused(press, "has no load cell; log fx_N, fy_N and fz_N in log.csv.")
    normal = pad.pose[:, :3, 2]
    cell = np.einsum("ti,ti->t", recording.wrench_N[:, :3], normal)
    gain = gel_gain(cell, pad.force_N[:, :, 2].sum(axis=1), source=str(press))
    if "spread" in described:
        known_to = float(np.hypot(gain.sd / gain.value, gain.residual))
        described["spread"]["force"] = round(max(known_to, LEAST_KNOWN_TO), 4)
    gel = described["gel"]
    gel["E_MPa"] = float(f"{gel['E_MPa'] * gain.value:.5g}")
    return (
        f"E_MPa {gel['E_MPa']:.4g} +- {gel['E_MPa'] * gain.sd / gain.value:.2g} "
        f"({gain.value:.3f} times the description's; load cell and gel agree within "
        f"{100 * gain.residual:.1f} % of the peak)"
    )
