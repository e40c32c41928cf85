"""Ages of calibrations on the day of the grasps, compared with the batch's own limit in days."""

from collections.abc import Iterator
from datetime import date
from pathlib import Path

from pipeline.batch.rig_setting import rig_path
from pipeline.batch.settings import Settings
from tactile.readers.rig_file import read_rig
from tactile.tactile_failure import TactileFailure


def old_calibrations(root: Path, settings: Settings, *, graded_on: date) -> Iterator[str]:
    """A sentence for each calibration that is older than the limit, or later than the grasps; none without a
    limit.
    """
    if (most_days := settings.calibration_days) is None:
        return
    day = settings.measured_on or graded_on
    for what, made, again in _dated(root, settings):
        days = (day - made).days
        if days < 0:
            yield (
                f"The {what} is dated {made}, after the grasps ({day}). Correct the date, or measured_on in "
                "batch.toml."
            )
        elif days > most_days:
            yield (
                f"The {what} is dated {made}, {days} days before the grasps ({day}); the limit is "
                f"{most_days} days (calibration_days in batch.toml). {again}"
            )


def _dated(root: Path, settings: Settings) -> Iterator[tuple[str, date, str]]:
    if settings.sensor is not None and settings.sensor.calibrated_on is not None:
        again = "Calibrate the sensor again (drupe calibrate), and correct calibrated_on."
        yield "calibration of the sensor", settings.sensor.calibrated_on, again
    path = rig_path(root, settings)
    try:
        made = None if path is None else read_rig(path).made
    except TactileFailure:  # grading reports it
        return
    if made is not None:
        yield "calibration of the rig", made, "Calibrate the rig again (drupe calibrate --rigid)."
