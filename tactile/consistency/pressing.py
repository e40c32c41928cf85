"""A pad's signals prepared for checks: without offsets, with their noise, and where the gel is pressed.

They include the displacement that the gel's law predicts from the forces. A gel whose stiffness per area was
measured is a bed of springs, u = f / (A k), marker by marker. A gel with known thickness, modulus and
Poisson's ratio is an elastic slab if its stated stiffness is that of its bonded layer (tactile/gel/slab.py).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactile.gel.slab import GelSlab, tent_compliance
from tactile.readers.recording import GelPad, marker_area_mm2
from tactile.sensors import bonded_stiffness

SAME_STIFFNESS = 0.02
"""A stated stiffness this near to the bonded layer's was computed from it (tactile/sensors.py)."""
MOST_FOR_SLAB = 900
"""Most markers for which the slab's compliance is computed. The matrix (3n x 3n) takes 60 MB. Its lookup
table has an eighth of the markers' spacing and extends 8 thicknesses beyond them: some 220 MB on a face of 20
mm. More markers have no law: a bed of springs is a poor one for a slab (0.46 of the force at 961 markers)."""
QUIET_SHARE = 10.0
"""Percentage of the frames first assumed to touch nothing; recordings here have 40 to 72 % of no-contact
frames (benchmarks/field_spreads.py)."""
QUIET_OVER = 1.5
"""Quiet frames have a root mean square of forces, and of displacements, up to this multiple of the
quietest's: 400 markers' noise varies by 2 %, and a first contact of a tenth of them at 6 standard deviations
makes 1.5."""
PRESSED_SD = 6.0
"""A marker is pressed where its force or its displacement exceeds this many standard deviations of noise: by
chance one of 400 markers in 100 frames does so in one recording of 300."""
LEAST_SHARE = 0.1
"""And this share of the largest, so that a noisy channel does not count as pressed."""
FEWEST_PRESSED = 3
"""Fewest markers pressed at once that make a contact: one or two may be outliers of the noise."""
HEAVIEST = 5
"""Number of most pressed frames whose mean the checks use. It has a little over half of one frame's noise.
Valid recordings have 3 to 14 frames above 90 % of the peak (benchmarks/field_spreads.py), so that all five
are near it."""
DEEPEST = 0.98
"""Quantile of the markers' indentation used for the gel's: the last 2 % may be outliers. Set by hand."""
FRAMES_SIMILAR = 1.5
"""Variance of a mean over the heaviest frames, over that of independent noise: noise of successive frames is
correlated (a correlation of 0.3 in samples/mismatch/marker_sensor.py makes 1.3 for two, 1.6 for five)."""
LEAST_OVER_NOISE = 3.0
"""Least normal displacement of the most pressed markers over noise, in the mean of the heaviest frames. A
smaller one says nothing about a gel's law. Valid gels have 18 and more (1 over benchmarks/field_spreads.py's
noise)."""
MOST_OF_TOP = 5
"""Number of markers averaged for the peak, so that no single one's noise sets it."""


def displacement_of(pad: GelPad, force_N: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "t n 3"] | None:
    """Displacement (mm, with the sign of the force) that the gel's law predicts from these marker forces.

    None if no law is known: fewer than nine markers do not determine the area of one, and a slab with more
    than MOST_FOR_SLAB markers is not computed.
    """
    area_mm2 = marker_area_mm2(pad.rest_mm)
    if area_mm2 is None:
        return None
    slab = slab_of(pad)
    if slab is not None and len(pad.rest_mm) > MOST_FOR_SLAB:
        return None
    if slab is None:
        stiffness = np.array([pad.gel_kt_MPa_per_mm, pad.gel_kt_MPa_per_mm, pad.gel_kn_MPa_per_mm])
        return np.asarray(force_N / (area_mm2 * stiffness))
    n = len(pad.rest_mm)
    compliance = _compliance(slab, pad.rest_mm[:, :2].tobytes(), float(np.sqrt(area_mm2)))
    return np.asarray(force_N.reshape(-1, 3 * n) @ compliance.T).reshape(force_N.shape)


@lru_cache(maxsize=2)
def _compliance(slab: GelSlab, places: bytes, pitch_mm: float) -> Float[np.ndarray, "m m"]:
    """Compliance of a slab's markers (0.5 s for 400), cached for transformations that keep their places."""
    flat = np.frombuffer(places).reshape(-1, 2)
    return tent_compliance(slab, flat, flat, pitch_mm=pitch_mm).reshape(3 * len(flat), -1)


def slab_of(pad: GelPad) -> GelSlab | None:
    """The slab from which the pad's forces were computed; None if its stiffness was measured."""
    E, nu, h = pad.gel_E_MPa, pad.gel_nu, pad.thickness_mm
    if E is None or nu is None or h is None or not nu < 0.5:
        return None
    bonded, _ = bonded_stiffness(E, nu, h)
    if abs(np.log(pad.gel_kn_MPa_per_mm / bonded)) > SAME_STIFFNESS:
        return None
    return GelSlab(thickness_mm=h, E_MPa=E, nu=nu)


@dataclass(frozen=True, kw_only=True)
class Pressing:
    """One pad. `gel_mm` is the displacement of each marker that its force and the gel's law predict, x, y, z.

    `felt_mm` is the measured one, with the sign of the force (positive z: pressed in). Both are relative to
    the quiet frames. `pressed[t, n]` is by force or displacement; `near` are each marker's nearest four.
    `gel_mm` is None if no law of the gel is known (`displacement_of`).
    """

    pad: GelPad
    felt_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    gel_mm: Float[np.ndarray, "t n 3"] | None
    felt_sd_mm: float
    force_sd_N: float
    quiet: Bool[np.ndarray, " t"]
    pressed: Bool[np.ndarray, "t n"]
    near: Int[np.ndarray, "n k"]
    spacing_mm: float

    @property
    def pads(self) -> tuple[str]:
        """The pad's name, as findings and misfits take it."""
        return (self.pad.name,)

    @cached_property
    def touched(self) -> Bool[np.ndarray, " n"]:
        """Markers that are pressed in at least two frames."""
        return np.asarray(self.pressed.sum(axis=0) >= 2)

    @cached_property
    def heaviest(self) -> Int[np.ndarray, " h"]:
        """The frames in which the pad is pressed most, by force and displacement together."""
        sizes = [np.sqrt((values**2).sum(axis=(1, 2))) for values in (self.felt_mm, self.force_N)]
        size = np.sum([x / max(float(x.max()), 1e-30) for x in sizes], axis=0)
        return np.asarray(np.argsort(-size, kind="stable")[:HEAVIEST])

    @property
    def closing_mm(self) -> Float[np.ndarray, " t"]:
        """The pad's travel along its own normal since the first frame."""
        pose = self.pad.pose
        return np.asarray((pose[:, :3, 3] - pose[0, :3, 3]) @ pose[0, :3, 2])


def pressing_of(pad: GelPad) -> Pressing:
    """The pad's signals without their offset; the pressed markers follow from the signals."""
    quiet = _quiet(pad)
    felt = -(pad.displacement_mm - np.median(pad.displacement_mm[quiet], axis=0))
    force = pad.force_N - np.median(pad.force_N[quiet], axis=0)
    gel = displacement_of(pad, force)
    felt_sd, force_sd = _noise(felt, quiet), _noise(force, quiet)
    near = min(5, len(pad.rest_mm))
    apart, who = cKDTree(pad.rest_mm).query(pad.rest_mm, k=near)
    apart, who = np.asarray(apart).reshape(len(pad.rest_mm), -1), np.asarray(who).reshape(len(apart), -1)
    return Pressing(
        pad=pad,
        felt_mm=felt,
        force_N=force,
        gel_mm=gel,
        felt_sd_mm=felt_sd,
        force_sd_N=force_sd,
        quiet=quiet,
        pressed=_beyond(felt, felt_sd) | _beyond(force, force_sd),
        near=who[:, 1:],
        spacing_mm=float(np.median(apart[:, 1:2])) if near > 1 else 0.0,
    )


def _quiet(pad: GelPad) -> Bool[np.ndarray, " t"]:
    """Frames of least force and displacement; a field that never changes is ignored."""
    quiet = np.ones(len(pad.force_N), dtype=bool)
    for values in (pad.force_N, pad.displacement_mm):
        size = np.sqrt((values**2).mean(axis=(1, 2)))
        least = size <= QUIET_OVER * np.percentile(size, QUIET_SHARE)
        if np.ptp(size) > 0 and (quiet & least).any():
            quiet &= least
    return quiet


def _noise(values: Float[np.ndarray, "t n 3"], quiet: Bool[np.ndarray, " t"]) -> float:
    """Standard deviation of one component in quiet frames."""
    return float(np.sqrt((values[quiet] ** 2).mean()))


def _beyond(values: Float[np.ndarray, "t n 3"], sd: float) -> Bool[np.ndarray, "t n"]:
    size = np.linalg.norm(values, axis=2)
    return np.asarray(size > max(PRESSED_SD * sd, LEAST_SHARE * float(size.max()), 1e-12))


def at_peak(press: Pressing, field: Float[np.ndarray, "t n 3"]) -> tuple[Float[np.ndarray, "n 3"], float]:
    """A field's mean over the heaviest frames, and the standard deviation of its noise."""
    top = press.heaviest
    return field[top].mean(axis=0), _noise(field, press.quiet) * float(np.sqrt(FRAMES_SIMILAR / len(top)))


def clearer(press: Pressing) -> tuple[Float[np.ndarray, "t n 3"], float]:
    """Displacement or force, whichever has less noise relative to its signal, and its noise; positive z:
    pressed."""
    shares = noise_shares(press)
    return (press.felt_mm, press.felt_sd_mm) if shares[0] <= shares[1] else (press.force_N, press.force_sd_N)


def gives_way(press: Pressing) -> bool:
    """Whether the gel moves, or should by its law, by more than its markers' noise: a stiff one does not."""
    top = press.heaviest
    fields = [press.felt_mm, *([] if press.gel_mm is None else [press.gel_mm])]
    least = LEAST_OVER_NOISE * press.felt_sd_mm
    return any(float(np.quantile(np.abs(f[top, :, 2].mean(axis=0)), DEEPEST)) >= least for f in fields)


def noise_shares(press: Pressing) -> tuple[float, float]:
    """Noise of displacement and of force over the signal of the most pressed markers."""
    top = press.heaviest
    peaks = [
        float(np.sort(np.abs(field[top, :, 2].mean(axis=0)))[-MOST_OF_TOP:].mean())
        for field in (press.felt_mm, press.force_N)
    ]
    return press.felt_sd_mm / max(peaks[0], 1e-30), press.force_sd_N / max(peaks[1], 1e-30)
