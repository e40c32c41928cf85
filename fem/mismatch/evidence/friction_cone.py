"""The friction cone: how the markers' shear lies to their pressure, which needs no model of the fruit.

Coulomb's law allows |f_t| <= mu f_n at every marker in every frame. Two things can be seen of it. A marker
beyond the cone of some mu, by more than noise and scale errors, refutes that mu: what remains is a smallest
mu. And markers that slip lie on the cone: so many of them just at mu as there are in no smooth distribution,
and none above.

Where the gel is a bed of springs (its forces are its displacements times two stiffnesses, within the forces'
noise) the displacements tell the ratio many times better than the forces; elsewhere the forces do.

    ln ratio(mu) = n1 ln(n1 / m) + n2 ln(n2 / m) - ln(tried) - sum over markers of (z^2 - 16) / 2,   n1 > n2

n1, n2: markers within two standard deviations of mu, and in the windows as wide just below and just above it
together, m their mean (the likelihood ratio of two Poisson counts, one-sided, against a smooth distribution
that is twice as dense at mu as around it: its top); z: by how many standard
deviations a marker exceeds mu at most, where that is more than 4. A marker's frames count together as one:
they are not independent. Only where the window below ends above nothing are they counted: a ratio is the size
of a vector, of which noise leaves few near nothing, so that ratios known no better than to themselves pile up
at their own noise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse

FIRM = 4.0
"""A marker's pressure counts from so many standard deviations of its noise."""
BEYOND = 4.0
"""So many standard deviations above the cone refute it."""
MOST_PER_MARKER = 20.0
"""No single marker says more than this against a cone."""
AT, ASIDE = 2.0, 6.0
"""A marker is at a cone to so many standard deviations, and around it from there on to so many."""
TRIED = np.geomspace(0.05, 1.2, 65)
"""mu looked at, 5 % apart: from slippery to where nothing slips."""
LEAST_LOSS = 6.0
"""Markers that refute a mu by more than this together: it is too small."""
NO_SPRING = 1e-9
"""Stiffness, N/mm, of a gel whose forces do not grow with its displacement."""
LOCAL = 2.0
"""Variance of the forces about their springs, over their noise, up to which the gel is a bed of springs."""


@dataclass(frozen=True, kw_only=True)
class ShearRatios:
    """|f_t| / f_n of markers in frames in which they press well above noise; its spread; whose it is."""

    ratio: Float[np.ndarray, " m"]
    sd: Float[np.ndarray, " m"]
    marker: Int[np.ndarray, " m"]

    def loss(self, mu: float) -> float:
        """What the markers beyond this cone say against it, in ln likelihood."""
        z = (self.ratio - mu) / self.sd
        most = np.zeros(int(self.marker.max(initial=-1)) + 1)
        np.maximum.at(most, self.marker, z)
        excess = (most**2 - BEYOND**2) / 2
        return float(np.minimum(excess[most > BEYOND], MOST_PER_MARKER).sum())

    def pile_up(self, mu: float) -> float:
        """How much more likely so many markers at mu are with a pile-up than with none, in ln likelihood."""
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
        """ln ratio of the module's docstring."""
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
    """The smallest of the mu tried that no marker beyond its cone refutes; the greatest where all are."""
    allowed = (float(mu) for mu in TRIED if ratios.loss(mu) < LEAST_LOSS)
    return next(allowed, float(TRIED[-1])) if len(ratios.ratio) else float(TRIED[-1])


def in_pad_frame(
    recording: GraspResponse, pad: int, values: Float[np.ndarray, "f n 3"]
) -> Float[np.ndarray, "f m 3"]:
    """Vectors of the fruit frame, of one pad's markers, in that pad's axes."""
    turn = recording.pose[pad][:, :3, :3]
    return np.asarray(np.einsum("fji,fnj->fni", turn, values[:, recording.pad_of_marker == pad]))


def spring_ratio(model: CaseModel, pad_name: str) -> float:
    """k_t / k_n of one pad's gel, all recordings together: its forces per displacement along and across."""
    normal, shear, _ = _springs(model, pad_name)
    return shear / normal


def normal_stiffness(model: CaseModel, pad_name: str) -> float:
    """k_n of one marker of a pad's gel, N/mm, all recordings together."""
    return _springs(model, pad_name)[0]


def _springs(model: CaseModel, pad_name: str) -> tuple[float, float, bool]:
    """Force per displacement along the normal and across, N/mm; whether that is all of the forces."""
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
    """Pressure and shear of one pad's markers, N, with their noise; by springs where the gel is such."""
    normal, shear, local = springs
    gel_sd, force_sd = _noise(recording, pad)
    if not local:
        force = in_pad_frame(recording, pad, recording.force_N)
        return force[..., 2], force[..., :2], force_sd, force_sd
    gel = _gel(recording, pad)
    return -normal * gel[..., 2], shear * gel[..., :2], normal * gel_sd, shear * gel_sd
