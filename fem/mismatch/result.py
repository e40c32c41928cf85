"""What the mismatch finder says of one fruit's recordings: everything a page or a file is written from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

NINETY = float(ndtri(0.95))
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""
NONE, UNKNOWN = "none", "unknown"
"""Verdicts that are no effect: nothing found, and something found that no effect explains."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of an effect with its standard deviation and 90 % interval; `sd` None: not estimated.

    A vector (a centre, an offset) has one number per component, a name (a pad) none at all.
    """

    value: float | tuple[float, ...] | str
    sd: float | tuple[float, ...] | None
    unit: str
    interval: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Modulus:
    """E and its standard deviation, MPa."""

    value: float
    sd: float

    def widened(self, relative_sd: float) -> "Modulus":
        """With so much more standard deviation of ln E, in squares."""
        return replace(self, sd=float(np.hypot(self.sd, relative_sd * self.value)))


def mixture(weights: Sequence[float], moduli: Sequence[Modulus], *, about: float | None = None) -> Modulus:
    """E that is one of several, each normal, by their weights (any sum above zero): the mean, or `about` in
    its place, and a standard deviation whose 90 % interval about that holds the central 90 % of the mixture.
    A component of little weight hardly widens it, however uncertain it is.
    """
    share = np.asarray(weights) / np.sum(weights)
    value = np.array([modulus.value for modulus in moduli])
    sd = np.maximum([modulus.sd for modulus in moduli], np.finfo(float).tiny)
    centre = float(share @ value) if about is None else about
    ends = float((value - 10 * sd).min()), float((value + 10 * sd).max())
    low, high = (
        brentq(lambda E, level=level: share @ ndtr((E - value) / sd) - level, *ends) for level in (0.05, 0.95)
    )
    return Modulus(value=centre, sd=max(centre - low, high - centre) / NINETY)


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One explanation in the ranking: an effect, or two joined by "+", sorted.

    `log_evidence`: natural logarithm of the marginal likelihood over that of the plain model, by linear
    signatures or, where `refitted`, by full models. `gain`: by how much chi-square falls. `heldout`: gain in
    log predictive density on grasps left out, against no effect, and its standard error. `refitted`: with the
    effect's full nonlinear model.
    """

    effect: str
    probability: float
    parameters: dict[str, Parameter]
    log_evidence: float
    gain: float
    heldout: tuple[float, float] | None = None
    refitted: bool = False
    modulus: Modulus | None = None


@dataclass(frozen=True, kw_only=True)
class Where:
    """Where the mismatch sits: a region in words, and for a spot in the flesh its centre and radius."""

    region: str
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Normalised force residual on grasps that the fit did not see: before, after, and what noise leaves."""

    rms_before: float
    rms_after: float
    noise_rms: float


@dataclass(frozen=True, kw_only=True)
class GraspTrace:
    """One recording through the fit of the *others*: force on the pads over how far the flesh gave way.

    `given_mm`: measured mean approach of the pads' markers; `before_mm`, `after_mm`: what the models give
    under the measured force. Per frame in contact; `phase` as in the recording.
    """

    grasp: str
    time_s: Float[np.ndarray, " t"]
    phase: tuple[str, ...]
    force_N: Float[np.ndarray, " t"]
    given_mm: Float[np.ndarray, " t"]
    before_mm: Float[np.ndarray, " t"]
    after_mm: Float[np.ndarray, " t"]


@dataclass(frozen=True, kw_only=True)
class ModulusCell:
    """The secant modulus of one grasp, pad and frame: the table shows when and where the model misses."""

    grasp: str
    pad: str
    time_s: float
    phase: str
    E_MPa: float
    E_sd_MPa: float


@dataclass(frozen=True, kw_only=True)
class FruitMap:
    """Maps on the fruit's skin, one number per vertex, each divided by its own noise (standard scores).

    `modulus_score`: softer (negative) or stiffer (positive) flesh below would explain the residual.
    `visible`: how well a spot of soft flesh there could be seen at all, its signal over noise; below three is
    the blind zone.
    """

    vertices_mm: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]
    modulus_score: Float[np.ndarray, " n"]
    visible: Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """The answer. `verdict`: "none", "unknown", one effect, or several that cannot be told apart.

    `statistics`: each detection statistic's own p-value; `p_nominal`: what they assume without a
    calibration, None where there is one. `notes`: sentences a reader must know (one grasp
    only, the category's pit used). `next_grasp`: what to record next, None where nothing is left to
    tell apart. `withheld`: why no E is given (of a bare ball's
    trace), which is then not a number in `before`, `after` and `ranking`. `left_out`: places of recordings
    that do not belong to the others; the first notes say why.
    """

    detected: bool
    p_value: float
    statistics: dict[str, float]
    where: Where
    when: str
    component: str
    ranking: tuple[Candidate, ...]
    verdict: str | tuple[str, ...]
    before: Modulus
    after: Modulus
    heldout: HeldOut | None
    next_grasp: str | None
    cells: tuple[ModulusCell, ...] = ()
    traces: tuple[GraspTrace, ...] = ()
    maps: FruitMap | None = None
    notes: tuple[str, ...] = ()
    seconds: dict[str, float] | None = None
    withheld: str | None = None
    p_nominal: str | None = None
    left_out: tuple[int, ...] = ()
