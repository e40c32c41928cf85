"""The friction cone: ratio of shear to normal force at the markers, which needs no model of the fruit.

Coulomb's law allows |f_t| <= mu f_n at every marker in every frame. It has two observable consequences. A
marker outside the cone of some mu, by more than noise and scale errors, refutes that mu; so there is a lower
bound of mu. And slipping markers lie on the cone: more ratios accumulate at mu than in a smooth distribution,
and none exceeds it.

If the gel is a bed of springs (its forces are its displacements times two stiffnesses, within the forces'
noise), the displacements give the ratio many times better than the forces; otherwise the forces give it.

    ln ratio(mu) = n1 ln(n1 / m) + n2 ln(n2 / m) - ln(tried) - sum over markers of (z^2 - 16) / 2,   n1 > n2

n1: markers within two standard deviations of mu; n2: markers in the two windows of equal width just below and
just above; m: mean of n1 and n2. This is the one-sided likelihood ratio of two Poisson counts against a
smooth distribution that is twice as dense at mu, its peak, as around it. z: a marker's greatest excess over
mu in standard deviations, if that is more than 4. All frames of a marker count as one, since they are not
independent. Ratios count only if the lower window ends above zero. A ratio is the norm of a vector, and noise
leaves few norms near zero, so imprecise ratios accumulate at their own noise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse

FIRM = 4.0
"""A marker counts above this many standard deviations of its normal force."""
BEYOND = 4.0
"""A marker this many standard deviations above a cone refutes it."""
MOST_PER_MARKER = 20.0
"""Greatest log likelihood of one marker against a cone."""
AT, ASIDE = 2.0, 6.0
"""Standard deviations from a cone up to which a marker is at it, and from there up to which around it."""
TRIED = np.geomspace(0.05, 1.2, 65)
"""Values of mu tried, 5 % apart: from slippery to where nothing slips."""
LEAST_LOSS = 6.0
"""A mu is too small if all markers' log likelihood against it exceeds this."""
NO_SPRING = 1e-9
"""Stiffness, N/mm, of a gel whose forces do not grow with its displacement."""
LOCAL = 2.0
"""Residual variance of the springs' fit to the forces, over noise, below which a gel is a bed of springs."""


@dataclass(frozen=True, kw_only=True)
class ShearRatios:
    """|f_t| / f_n of markers in frames with a normal force well above noise; its deviation; the marker."""

    ratio: Float[np.ndarray, " m"]
    sd: Float[np.ndarray, " m"]
    marker: Int[np.ndarray, " m"]

    def loss(self, mu: float) -> float:
        """Log likelihood against this cone from the markers outside it."""
        z = (self.ratio - mu) / self.sd
        most = np.zeros(int(self.marker.max(initial=-1)) + 1)
        np.maximum.at(most, self.marker, z)
        excess = (most**2 - BEYOND**2) / 2
        return float(np.minimum(excess[most > BEYOND], MOST_PER_MARKER).sum())

    def pile_up(self, mu: float) -> float:
        """Log likelihood ratio of an accumulation of markers at mu over a smooth distribution."""
        known = self.sd < mu / ASIDE
        z, marker = (self.ratio[known] - mu) / self.sd[known], self.marker[known]
        share = 1 / np.maximum(np.bincount(marker, minlength=1), 1)[marker]
        at = float(share[np.abs(z) < AT].sum())
        around = float(share[(np.abs(z) >= AT) & (np.abs(z) < ASIDE)].sum())
        mean = (at + around) / 2
        if at <= around or mean < 1:
            return 0.0
        return float(at * np.log(at / mean) + (around * np.log(around / mean) if around > 0 else 0.0))

    def log_ratio(self, mu: float) -> float:
        """ln ratio(mu) of the module docstring."""
        return self.pile_up(mu) - self.loss(mu) - float(np.log(len(TRIED)))


def shear_ratios(model: CaseModel) -> ShearRatios:
    """Of all markers of all recordings."""
    scale = np.sqrt(2) * model.case.budget.force_scale_sd
    names = {name for recording in model.grasps for name in recording.pad_names}
    springs = {name: _springs(model, name) for name in names}
    ratio, sd, marker, before = [], [], [], 0
    for recording in model.grasps:
        for pad in range(len(recording.links)):
            normal, shear, normal_sd, shear_sd = _pressed(recording, pad, springs[recording.pad_names[pad]])
            frame, who = np.nonzero(normal > FIRM * normal_sd)
            size = np.linalg.norm(shear[frame, who], axis=1) / normal[frame, who]
            ratio.append(size)
            sd.append(np.hypot(np.hypot(shear_sd, size * normal_sd) / normal[frame, who], scale * size))
            marker.append(before + who)
            before += normal.shape[1]
    return ShearRatios(ratio=np.concatenate(ratio), sd=np.concatenate(sd), marker=np.concatenate(marker))


def least_mu(ratios: ShearRatios) -> float:
    """The smallest mu tried that markers outside its cone do not refute; the greatest if they refute all."""
    allowed = (float(mu) for mu in TRIED if ratios.loss(mu) < LEAST_LOSS)
    return next(allowed, float(TRIED[-1])) if len(ratios.ratio) else float(TRIED[-1])


def in_pad_frame(
    recording: GraspResponse, pad: int, values: Float[np.ndarray, "f n 3"]
) -> Float[np.ndarray, "f m 3"]:
    """Vectors at one pad's markers, from the fruit frame to that pad's axes."""
    turn = recording.pose[pad][:, :3, :3]
    return np.asarray(np.einsum("fji,fnj->fni", turn, values[:, recording.pad_of_marker == pad]))


def spring_ratio(model: CaseModel, pad_name: str) -> float:
    """k_t / k_n of one pad's gel, from all recordings: its shear stiffness over its normal stiffness."""
    normal, shear, _ = _springs(model, pad_name)
    return shear / normal


def normal_stiffness(model: CaseModel, pad_name: str) -> float:
    """k_n of one marker of a pad's gel, N/mm, all recordings together."""
    return _springs(model, pad_name)[0]


def _springs(model: CaseModel, pad_name: str) -> tuple[float, float, bool]:
    """Normal and shear stiffness of one marker, N/mm; whether these explain the forces within noise."""
    return model.memoised(("springs", pad_name), lambda: _fitted_springs(model, pad_name))


def _fitted_springs(model: CaseModel, pad_name: str) -> tuple[float, float, bool]:
    springs, local = [], True
    for part in (slice(2, 3), slice(0, 2)):
        work = moved = residual = noise = 0.0
        pairs = [
            (
                in_pad_frame(recording, pad, recording.force_N)[..., part],
                _gel(recording, pad)[..., part],
                _noise(recording, pad),
            )
            for recording in model.grasps
            for pad in range(len(recording.links))
            if recording.pad_names[pad] == pad_name
        ]
        for force, gel, (gel_sd, _) in pairs:
            work -= float((force * gel).sum())
            moved += float((gel**2).sum()) - gel.size * gel_sd**2
        stiffness = work / moved if work > 0 and moved > 0 else 0.0
        for force, gel, (gel_sd, force_sd) in pairs:
            residual += float(((force + stiffness * gel) ** 2).sum())
            noise += force.size * (force_sd**2 + (stiffness * gel_sd) ** 2)
        local &= stiffness > 0 and residual < LOCAL * noise
        springs.append(max(stiffness, NO_SPRING))
    return springs[0], springs[1], local


def _gel(recording: GraspResponse, pad: int) -> Float[np.ndarray, "f m 3"]:
    return in_pad_frame(recording, pad, recording.tracks.gel_displacement_mm)


def _noise(recording: GraspResponse, pad: int) -> tuple[float, float]:
    """Standard deviations of one component of displacement, mm, and force, N."""
    return float(recording.tracks.sd_mm[recording.pad_of_marker == pad][0]), recording.case.history.pads[
        pad
    ].force_sd_N


def _pressed(
    recording: GraspResponse, pad: int, springs: tuple[float, float, bool]
) -> tuple[Float[np.ndarray, "f m"], Float[np.ndarray, "f m 2"], float, float]:
    """Normal force and shear of one pad's markers, N, with their noise; from springs if the gel is such."""
    normal, shear, local = springs
    gel_sd, force_sd = _noise(recording, pad)
    if not local:
        force = in_pad_frame(recording, pad, recording.force_N)
        return force[..., 2], force[..., :2], force_sd, force_sd
    gel = _gel(recording, pad)
    return -normal * gel[..., 2], shear * gel[..., :2], normal * gel_sd, shear * gel_sd
