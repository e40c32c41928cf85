"""Gel sensors of a case and their noise: that of the sample batch, or random ones of a wide range."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from samples.gel_contact import DEFAULT_GEL, Gel


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Noise per component of a frame (AR(1)) and of the reference frame; scale errors per marker; steps."""

    displacement_mm: float = 0.004
    reference_mm: float = 0.002
    force_N: float = 0.005
    reference_N: float = 0.0026
    displacement_scale: float = 0.004
    force_scale: float = 0.01
    correlation: float = 0.3
    displacement_step_mm: float = 2.0**-13
    force_step_N: float = 2.0**-13


def measured(
    displacement_mm: Float[np.ndarray, "t n 3"],
    force_N: Float[np.ndarray, "t n 3"],
    noise: SensorNoise,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "t n 3"], Float[np.ndarray, "t n 3"]]:
    """Marker displacement and force from a sensor: true values with scale errors and noise, rounded."""
    lag1 = noise.correlation

    def sensed(truth: np.ndarray, sd: float, reference_sd: float, scale: float, step: float) -> np.ndarray:
        frames, markers, _ = truth.shape
        gain = 1.0 + scale * rng.normal(size=(markers, 1))
        coloured = rng.normal(size=truth.shape)
        for t in range(1, frames):
            coloured[t] = lag1 * coloured[t - 1] + np.sqrt(1 - lag1**2) * coloured[t]
        reference = rng.normal(size=(markers, 3))
        return np.asarray(np.rint((gain * truth + sd * coloured + reference_sd * reference) / step) * step)

    sds_mm, sds_N = (noise.displacement_mm, noise.reference_mm), (noise.force_N, noise.reference_N)
    return (
        sensed(displacement_mm, *sds_mm, noise.displacement_scale, noise.displacement_step_mm),
        sensed(force_N, *sds_N, noise.force_scale, noise.force_step_N),
    )


LEAST_MARKERS, MOST_MARKERS, PITCH_MM = 14, 22, (0.8, 1.3)
"""Range of markers along each side, and of their spacing, mm: as in published gels with markers (set by
hand)."""
DRAWN_NAME = "drawn gel"
"""Name of a random sensor: not that of a sensor model (tactile.readers.sensor_model), whose gel it lacks."""


@dataclass(frozen=True, kw_only=True)
class MarkerSensor:
    """Both pads' gel, its square grid of markers, its noise.

    `name`: in recordings. `force_share`: standard deviation of a marker's force over the pad's peak force.
    """

    name: str = "20x20 marker gel"
    gel: Gel = DEFAULT_GEL
    markers: int = 20
    pitch_mm: float = 1.0
    displacement_mm: float = 0.004
    force_share: float = 2e-4
    displacement_scale: float = 0.004
    force_scale: float = 0.01
    correlation: float = 0.3

    @property
    def rest_mm(self) -> Float[np.ndarray, "m 3"]:
        """The markers on the flat gel face."""
        line = (np.arange(self.markers) - (self.markers - 1) / 2) * self.pitch_mm
        x, y = np.meshgrid(line, line, indexing="ij")
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)

    @property
    def half_width_mm(self) -> float:
        """Half the gel's side: every marker represents a square of gel."""
        return self.markers * self.pitch_mm / 2

    def noise(self, peak_N: float) -> SensorNoise:
        """Noise of a recording whose pads push with `peak_N` at most."""
        size = self.force_share * peak_N
        return SensorNoise(
            displacement_mm=self.displacement_mm, reference_mm=self.displacement_mm / 2, force_N=size,
            reference_N=size / 2, force_step_N=2.0**-17, displacement_scale=self.displacement_scale,
            force_scale=self.force_scale, correlation=self.correlation,
        )  # fmt: skip


DEFAULT_SENSOR = MarkerSensor()
"""Sensor of the sample batch."""


def drawn_sensor(rng: np.random.Generator, *, contact_mm: float) -> MarkerSensor:
    """A random sensor whose gel is wider than a contact of that radius.

    kn is log-uniform in 0.1 to 0.5 MPa/mm, kt 0.2 to 0.35 of it, friction 0.5 to 1.1.
    """
    kn = float(np.exp(rng.uniform(np.log(0.1), np.log(0.5))))
    gel = Gel(
        kn_MPa_per_mm=kn, kt_MPa_per_mm=kn * float(rng.uniform(0.2, 0.35)),
        friction=float(rng.uniform(0.5, 1.1)),
    )  # fmt: skip
    sensor = MarkerSensor(name=DRAWN_NAME, gel=gel, markers=MOST_MARKERS, pitch_mm=PITCH_MM[1])
    for _ in range(40):
        markers, pitch = int(rng.integers(LEAST_MARKERS, MOST_MARKERS + 1)), float(rng.uniform(*PITCH_MM))
        if markers * pitch / 2 > contact_mm + pitch / 2:
            sensor = replace(sensor, markers=markers, pitch_mm=round(pitch, 2))
            break
    return with_drawn_noise(sensor, rng)


def with_drawn_noise(sensor: MarkerSensor, rng: np.random.Generator) -> MarkerSensor:
    """The same gel and markers with another camera: new random noise and scale errors."""
    return replace(
        sensor,
        displacement_mm=float(rng.uniform(0.002, 0.006)),
        force_share=float(np.exp(rng.uniform(np.log(1e-4), np.log(4e-4)))),
        displacement_scale=float(rng.uniform(0.002, 0.006)),
        force_scale=float(rng.uniform(0.005, 0.015)),
        correlation=float(rng.uniform(0.1, 0.5)),
    )
