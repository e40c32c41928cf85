"""The force at one place of the skin that balances the pads' forces: linear Gaussian inference.

m: sum of the pads' forces and moments; W: weight of fem.mismatch.model.marker_equations; columns
A = [1; (X - x0) x] phi_j(t) with amounts a = R u, u ~ N(0, 1) each:

    u = -(1 + R' M R)^-1 R' A' W m,   M = A' W A,   ln evidence = (-u . R' A' W m - ln det(1 + R' M R)) / 2

(linear Gaussian inference; Rasmussen and Williams 2006, eq. 2.11 and 5.8). R R' is the amounts' covariance.
In time, F along the skin's normal is a smooth function that grows with the load l, with covariance

    l l' (1 + g^2 (l l' + exp(-(t - t')^2 / 2 SMOOTH^2))) / (1 + 2 g^2),     t: share of the frames

times the square of a scale; R R' is its projection on phi_j, its leading functions at the last of FREEDOMS.
Each recording uses the pair of SCALES and FREEDOMS (g) with the largest evidence. Tangentially the standard
deviation is FRICTION times the normal one. A force that pulls, lies outside the CONE of friction, or acts
where a pad touches is rejected.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.marker_equations import BalanceEquations
from fem.mismatch.model.plain_model import ARM_MM, GraspResponse

SCALES = (0.005, 0.02, 0.08)
"""Prior standard deviations of the normal force at the greatest load, as shares of a pad's force then: from
one like the errors of marker scales to a fruit that is pressed against a table. Set by hand."""
FREEDOMS = (0.1, 1.0)
"""Standard deviation of the change of the force's share of the load in a recording, over its mean. A support
in permanent contact takes a nearly constant share, a stop with late contact any. Set by hand."""
SMOOTH, COURSES = 0.2, 6
"""Correlation length of the force's share of the load, as a share of a recording's frames (a phase of the
motion), and the number of functions that contain all but a percent of that covariance. Set by hand."""
FRICTION = 0.15
"""Prior of the tangential force over the normal one: small, as the normal of a scanned skin is itself
uncertain by some degrees. Set by hand."""
CONE = 0.3
"""Tangential over normal force beyond which it is not a contact force: some 17 degrees off the normal, where
skin on a palm slips. A pad that reads too high leaves a force along each grasp's axis; with grasps 45 degrees
apart, no place has two of them within its cone. Set by hand."""
CLEAR_MM = 4.0
"""A place belongs to a pad if one of its markers touches within this distance: two marker pitches."""


@dataclass(frozen=True, kw_only=True)
class ThirdForce:
    """F(t) of one recording, `sd_N` of its normal component, and ln `evidence` of F over no force.

    `volume`: the part of that evidence that does not come from the balance (Occam factor): ln of the prior at
    F and of the posterior's width over the prior's. Negative.
    """

    force_N: Float[np.ndarray, "f 3"]
    sd_N: Float[np.ndarray, " f"]
    evidence: float
    volume: float


@dataclass(frozen=True, kw_only=True)
class ForceBalance:
    """One recording's balance, projected on the functions phi_j of time, for all six force components.

    `touched_mm`: the markers that touch in any frame.
    `roots_N`: for each of SCALES and FREEDOMS a square root of the amounts' covariance.
    `normal`: (phi_j e_a) . W (phi_l e_b), 1/N2; `pushed`: -(phi_j e_a) . W m, 1/N.
    """

    recording: GraspResponse
    courses: Float[np.ndarray, "j f"]
    touched_mm: Float[np.ndarray, "n 3"]
    roots_N: Float[np.ndarray, "k m m"]
    normal: Float[np.ndarray, "j 6 j 6"]
    pushed: Float[np.ndarray, "j 6"]

    @classmethod
    def of(cls, recording: GraspResponse, balance: BalanceEquations) -> "ForceBalance":
        """The balance of a recording in which only pads hold the fruit."""
        courses, roots = _courses(recording)
        white = np.einsum("jf,fa,lf,ab->jalb", courses, balance.weight, courses, np.eye(6))
        across = np.einsum("kfa,fa,jf->kja", balance.nuisances, balance.weight, courses)
        held = np.einsum("kja,km,mlb->jalb", across, balance.inverse, across, optimize=True)
        return cls(
            recording=recording,
            courses=courses,
            touched_mm=recording.tracks.place_mm[recording.touching.any(axis=0)],
            roots_N=np.array(
                [
                    scale * peak_N(recording) * np.kron(root, np.diag([1.0, FRICTION, FRICTION]))
                    for scale in SCALES
                    for root in roots
                ]
            ),
            normal=white - held,
            pushed=-courses @ balance.weighed(balance.measured),
        )

    def force(self, place_mm: Float[np.ndarray, "3"], inward: Float[np.ndarray, "3"]) -> ThirdForce | None:
        """The force at a place that best balances the recording; None if none does or it is rejected."""
        if (np.linalg.norm(self.touched_mm - place_mm, axis=1) < CLEAR_MM).any():
            return None  # a pad touches there
        axes = axes_at(inward)
        arms = np.vstack([axes, np.cross(place_mm - self.recording.centre_mm, axes.T).T / ARM_MM])
        count = 3 * len(self.courses)
        half = (self.normal @ arms).reshape(-1, 6, count)
        normal = (arms.T @ half).reshape(count, count)
        pushed = (self.pushed @ arms).ravel()
        amounts, covariance, evidence, volume = _likeliest(normal, pushed, self.roots_N)
        local = self.courses.T @ amounts.reshape(-1, 3)
        pulls = self.recording.load @ local[:, 0] <= 0
        slides = np.linalg.norm(local[:, 1:]) > CONE * np.linalg.norm(local[:, 0])
        if evidence <= 0 or pulls or slides:
            return None
        spread = np.einsum("jf,jl,lf->f", self.courses, covariance[::3, ::3], self.courses)
        return ThirdForce(force_N=local @ axes.T, sd_N=np.sqrt(spread), evidence=evidence, volume=volume)


def _likeliest(
    normal: Float[np.ndarray, "m m"], pushed: Float[np.ndarray, " m"], roots_N: Float[np.ndarray, "k m m"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"], float, float]:
    """Posterior mean of the amounts (per phi_j normal, two tangential), covariance, ln evidence, volume.

    `roots_N`: square roots of prior covariances of the amounts. The one of greatest evidence counts.
    """
    turned = roots_N.transpose(0, 2, 1)
    pushes = turned @ pushed
    precision = np.eye(len(pushed)) + turned @ normal @ roots_N
    units = np.linalg.solve(precision, pushes[..., None])[..., 0]
    widths = -np.linalg.slogdet(precision)[1]
    evidences = ((units * pushes).sum(axis=1) + widths) / 2
    best = int(evidences.argmax())
    root_N, unit, width = roots_N[best], units[best], widths[best]
    covariance = root_N @ np.linalg.solve(precision[best], root_N.T)
    return root_N @ unit, covariance, float(evidences[best]), float((width - unit @ unit) / 2)


def _courses(
    recording: GraspResponse,
) -> tuple[Float[np.ndarray, "j f"], tuple[Float[np.ndarray, "j j"], ...]]:
    """phi_j, scaled to the force of an amount of one, and square roots of FREEDOMS' covariances."""
    load, share = recording.load, np.linspace(0.0, 1.0, len(recording.load))
    both = np.outer(load, load)
    change = both * (both + np.exp(-((share[:, None] - share) ** 2) / (2 * SMOOTH**2)))
    priors = [(both + freedom**2 * change) / (1 + 2 * freedom**2) for freedom in FREEDOMS]
    size, course = np.linalg.eigh(priors[-1])
    scale = np.sqrt(size[-COURSES:])
    courses, onto = (course[:, -COURSES:] * scale).T, (course[:, -COURSES:] / scale).T
    return courses, tuple(np.linalg.cholesky(onto @ prior @ onto.T) for prior in priors)


def peak_N(recording: GraspResponse) -> float:
    """Force of a pad at the greatest load, N, mean over the pads."""
    return float(np.linalg.norm(recording.force_N, axis=2).sum(axis=1).max()) / len(recording.links)


def axes_at(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The normal and two directions along the skin, as columns."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.column_stack([normal, first, np.cross(normal, first)])
