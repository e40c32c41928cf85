"""Uncertainty of E by the sensors' scales: of forces, of the gel's pictures, of both with the gel.

There are three scales. *Common*: one factor on forces and gel stiffness, which no recording shows.
*Pictures*: a factor on the gel's lengths and the forces computed from them. The markers' pitch does not
exclude it: rest positions may be as designed, or measured with another camera, and no recording says which.
*Gain*: a factor on forces alone, which the gel's law shows (tactile/consistency/gain.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.batch.settings import SensorSettings
from tactile.consistency.gain import unseen_gain
from tactile.plain_jaw import RIGID_MPA_PER_MM
from tactile.readers.recording import GelPad, Recording
from tactile.readers.sensor_model import PublishedGel, gel_of_model, model_named

COMMON_SD = 0.03
"""Relative standard deviation of an unstated common factor on force and gel stiffness. Assumed: the error
after a calibration on a load cell (by the cell, its alignment, the gel's temperature and wear)."""
PICTURE_SD = 0.05
"""The same for the scale of a gel's pictures: assumed, so that 10 % are two of them. The width of an imprint
on the mesh is no better: in recordings of a normal fruit it misses the scale by 0.02 and 0.07."""
E_PER_GAIN, E_PER_PICTURE = 1.1, 1.45
"""Error of ln E per ln of each (benchmarks/field_mistakes.py --grade). E is 0.081 off at a gain of 1.079. At
a scale of 1.1 it is 0.148 off if displacement and the forces computed from it have that scale. It is 0.077
off if places in the gel's plane have it, and forces its square, by each marker's area."""


@dataclass(frozen=True, kw_only=True)
class SensorScale:
    """Relative standard deviations of E. `common`: by the common factor on force and gel stiffness;
    `pictures`: by the scale of the gel's pictures; `gain`: by the forces' gain that all fruit of the gripper
    share; `own_gain`: by its part from these recordings alone.
    """

    common: float = 0.0
    pictures: float = 0.0
    gain: float = 0.0
    own_gain: float = 0.0

    @property
    def sd(self) -> float:
        """By all that recordings share: `common`, `pictures` and `gain` in squares."""
        return float(np.linalg.norm([self.common, self.pictures, self.gain]))


NO_SCALE = SensorScale()


def sensor_scale(recordings: Sequence[Recording], settings: SensorSettings | None) -> SensorScale:
    """Scale errors of E from all these recordings. Sensors of one kind share the first two errors, so that
    pads and grasps do not reduce them. Their values are the recordings' (force_scale_sd,
    displacement_scale_sd), else batch.toml's, else COMMON_SD and PICTURE_SD.
    """
    if not recordings:
        return NO_SCALE
    gain = unseen_gain([pad for recording in recordings for pad in _gels(recording)])
    stated = (None, None) if settings is None else (settings.common_scale_sd, settings.picture_scale_sd)
    common_sd, picture_sd = (
        default if sd is None else sd for sd, default in zip(stated, (COMMON_SD, PICTURE_SD), strict=True)
    )
    return SensorScale(
        common=_stated_sd(recordings, "force_scale_sd", common_sd),
        pictures=E_PER_PICTURE * _stated_sd(recordings, "displacement_scale_sd", picture_sd),
        gain=E_PER_GAIN * gain.shared,
        own_gain=E_PER_GAIN * gain.independent,
    )


def _stated_sd(recordings: Sequence[Recording], field: str, assumed: float) -> float:
    """The mean over recordings of the mean over the gels of each; 0 for one that has none."""
    gels = [[getattr(pad, field) or assumed for pad in _gels(recording)] for recording in recordings]
    return float(np.mean([np.mean(sds or [0.0]) for sds in gels]))


def _gels(recording: Recording) -> list[GelPad]:
    """Gel pads, without the one that replaces a plain jaw (tactile.plain_jaw)."""
    gels = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    return [pad for pad in gels if pad.gel_kn_MPa_per_mm < RIGID_MPA_PER_MM]


def known_gels(sensor: str, settings: SensorSettings | None) -> tuple[PublishedGel, ...]:
    """Gels of the sensor that a recording names; `settings`: [sensor] of the batch, whose stiffness is
    first."""
    model = model_named(sensor)
    shipped = () if model is None else (gel_of_model(model),)
    gel_stiffness = {} if settings is None else settings.gel_stiffness
    if not gel_stiffness:
        return shipped
    stated = PublishedGel(source="[sensor] in batch.toml", stiffness=gel_stiffness)
    others = {
        name: known for gel in shipped for name, known in gel.stiffness.items() if name not in gel_stiffness
    }
    return (stated, *(replace(gel, stiffness=others) for gel in shipped))
