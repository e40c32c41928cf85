"""What one recording of a fruit gave, as `record.json` holds it and the report shows it."""

from pydantic import BaseModel, ConfigDict


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True)


class ModelCurveRecord(_Record):
    """Travel of the fitted model under a pad's force, in the frames used; `sd_mm`: of it, by E's error."""

    travel_mm: list[float]
    force_N: list[float]
    sd_mm: list[float]


class CurveRecord(_Record):
    """Normal force of one pad against travel since first touch."""

    pad: str
    travel_mm: list[float]
    force_N: list[float]
    model: ModelCurveRecord | None = None


class FrameRecord(_Record):
    """E by one frame alone, by the noise of its markers; whether the jaws were opening."""

    travel_mm: float
    E_MPa: float
    E_sd_MPa: float
    unloading: bool = False


class GraspRecord(_Record):
    """What one recording gave; `failure` says why it gave nothing."""

    grasp: str
    failure: str | None = None
    digest: str = ""
    """Of the displacements and forces that it was made of (tactile.recording_digest)."""
    E_MPa: float | None = None
    E_sd_MPa: float | None = None
    parts_sd_MPa: dict[str, float] = {}
    discretisation: float | None = None
    E_energy_MPa: float | None = None
    E_energy_sd_MPa: float | None = None
    E_least_squares_MPa: float | None = None
    E_least_squares_sd_MPa: float | None = None
    residual_um: float | None = None
    noise_um: float | None = None
    registration_mm: float | None = None
    frames_used: int | None = None
    markers_used: int | None = None
    peak_force_N: float | None = None
    """The largest normal force of any one pad in any frame: not the sum of the pads."""
    travel_mm: float | None = None
    contact_mm: dict[str, list[tuple[float, float, float]]] = {}
    curves: list[CurveRecord] = []
    frames: list[FrameRecord] = []
