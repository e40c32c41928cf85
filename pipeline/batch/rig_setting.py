"""`rig = "rig.toml"` in batch.toml: the jaws' machine compliance; drupe corrects every recording for it."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.batch.confirmed_effects import ConfirmedEffect, faults
from pipeline.batch.settings import Settings
from tactile.correction import Fault, RigFault
from tactile.readers.rig_file import read_rig
from tactile.rig.rig_curve import RigCurve


def rig_path(root: Path, settings: Settings) -> Path | None:
    """Path of the batch's rig file, which batch.toml gives relative to itself; None if it gives none."""
    return None if settings.rig is None else root / settings.rig


def batch_rig(root: Path, settings: Settings) -> RigCurve | None:
    """The compliance curve of the batch's jaws; raises TactileFailure for a file that is no rig."""
    path = rig_path(root, settings)
    return None if path is None else read_rig(path).machine


def jaw_faults(effects: Sequence[ConfirmedEffect], rig: RigCurve | None) -> tuple[Fault, ...]:
    """The faults for which drupe corrects every recording: confirmed ones of the jaws, and compliance."""
    return (*faults(effects), *([] if rig is None else [RigFault(curve=rig)]))
