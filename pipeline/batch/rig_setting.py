"""`rig = "rig.toml"` in batch.toml: how far the batch's jaws give way, which every recording is rid of."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.batch.confirmed_effects import ConfirmedEffect, faults
from pipeline.batch.settings import Settings
from tactile.correction import Fault, RigFault
from tactile.readers.rig_file import read_rig
from tactile.rig.rig_curve import RigCurve


def rig_path(root: Path, settings: Settings) -> Path | None:
    """Where the batch's rig lies, relative to batch.toml; None where it names none."""
    return None if settings.rig is None else root / settings.rig


def batch_rig(root: Path, settings: Settings) -> RigCurve | None:
    """What the batch's jaws give; raises TactileFailure for a file that is no rig."""
    path = rig_path(root, settings)
    return None if path is None else read_rig(path).machine


def jaw_faults(effects: Sequence[ConfirmedEffect], rig: RigCurve | None) -> tuple[Fault, ...]:
    """All that is taken out of every recording: confirmed faults of the jaws, and what their rig gives."""
    return (*faults(effects), *([] if rig is None else [RigFault(curve=rig)]))
