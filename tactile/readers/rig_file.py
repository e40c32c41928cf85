"""A rig's description in TOML, as `drupe calibrate` writes it from squeezes of a rigid object.

The curve [travel] is that of the whole path, [jaws] that without the gels' displacement. Both list a
displacement and its standard deviation over the force (docs/formats.md).
"""

import datetime
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

from pipeline.files.plain_file import NotReadable, read_bytes
from tactile.readers.recording_fields import Limit
from tactile.readers.toml_table import MOST_BYTES, Table, read_table
from tactile.rig.rig_curve import RigCurve
from tactile.tactile_failure import TactileProblem

FORMAT = "drupe-rig"
VERSION = 1
"""Of the file; docs/formats.md describes it."""
SHAPES = ("ball", "block")
SIZE = Limit(1000.0, "millimetres", least=0.1)
"""Size of a rigid object: no jaws open wider, and none hold a smaller one."""
CURVES = {"force_N", "give_mm", "sd_mm"}
TOP = {
    "format", "version", "object", "shape", "size_mm", "made", "squeezes", "least_N", "travel", "jaws",
    "gels", "spread", "recordings",
}  # fmt: skip
FEWEST_KNOTS = 2
"""Fewest points of a curve."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """`travel`: displacement of the whole path, with gels; `jaws`: without them, None if no gels were
    measured.

    `made`: the day of its calibration, None if the file lacks it. `digest`: SHA-256 of the file.
    """

    object_name: str
    shape: Literal["ball", "block"]
    size_mm: float
    travel: RigCurve
    jaws: RigCurve | None
    made: datetime.date | None
    digest: str

    @property
    def machine(self) -> RigCurve:
        """Displacement of jaws and frame; with the gels if nobody measured it without them."""
        return self.jaws or self.travel


def read_rig(path: Path) -> Rig:
    """The rig that `path` describes; raises TactileFailure (unreadable-sensor) that names file and field."""
    top = read_table(path, TactileProblem.UNREADABLE_SENSOR, what="a rig's description (drupe calibrate)")
    top.require_format(FORMAT, VERSION)
    top.refuse_unknown(TOP)
    travel = _curve(top, "travel")
    if travel is None:
        raise top.refusal("travel", "nothing", "a table [travel] with force_N, give_mm and sd_mm")
    try:
        digest = hashlib.sha256(read_bytes(path, most_bytes=MOST_BYTES)).hexdigest()
    except NotReadable as cause:
        raise TactileProblem.UNREADABLE_SENSOR.failure(f"{path.name}: {cause}.") from cause
    return Rig(
        object_name=top.text("object"),
        shape=cast(Literal["ball", "block"], top.choice("shape", SHAPES)),
        size_mm=cast(float, top.within("size_mm", SIZE, needed=True)),
        travel=travel,
        jaws=_curve(top, "jaws"),
        made=top.day("made"),
        digest=digest,
    )


def _curve(top: Table, name: str) -> RigCurve | None:
    """One curve of the file, None if it lacks it. Raises TactileFailure if it is wrong."""
    table = top.table(name, needed=False)
    if not table:
        return None
    table.refuse_unknown(CURVES)
    force = table.numbers("force_N", (None,))
    if len(force) < FEWEST_KNOTS or force[0] != 0.0 or not (np.diff(force) > 0).all():
        raise table.refusal("force_N", f"{len(force)} forces from {force[0]:g}", "forces that grow from 0")
    give, sd = (table.numbers(key, (len(force),)) for key in ("give_mm", "sd_mm"))
    if give[0] != 0.0 or (np.diff(give) < 0).any():
        raise table.refusal("give_mm", "a give that falls, or is not 0 without force", "one that never falls")
    if (sd < 0).any() or not (sd[1:] > 0).all():
        raise table.refusal("sd_mm", f"{sd.min():g}", "a standard deviation above 0 wherever there is force")
    return RigCurve(force_N=force, give_mm=give, sd_mm=sd)
