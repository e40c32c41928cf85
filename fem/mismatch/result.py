"""Result of the mismatch finder for one fruit's recordings, from which pages and files are written."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

NINETY = float(ndtri(0.95))
"""Standard deviations on either side of the mean that include 90 % of a normal distribution."""
NONE, UNKNOWN = "none", "unknown"
"""Verdicts without an effect: no mismatch, and a mismatch that no effect explains."""


def in_words(effect: str) -> str:
    """The name of an effect or of a pair, as in sentences.

    >>> in_words("pit_offset+slip")
    'pit offset with slip'
    """
    return effect.replace("_", " ").replace("+", " with ")


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of an effect with its standard deviation and 90 % interval; `sd` None: not estimated.

    A vector (a centre, an offset) has one number per component, a name (a pad) has none.
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
        """With a further standard deviation of ln E, added in quadrature."""
        return replace(self, sd=float(np.hypot(self.sd, relative_sd * self.value)))


def mixture(weights: Sequence[float], moduli: Sequence[Modulus], *, about: float | None = None) -> Modulus:
    """E of a mixture of normal distributions with these weights (any sum above zero): its mean, or `about`
    instead. The 90 % interval of its standard deviation contains the central 90 % of the mixture. A component
    of little weight hardly widens it, however uncertain it is.
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
    signatures or, if `refitted`, by full models. The probability also allows for errors of the effects' laws
    (`hidden` of fem.mismatch.selection.decision). `gain`: decrease of chi-square. `heldout`: gain in log
    predictive density on held-out grasps over no effect, and its standard error. `refitted`: by the effect's
    full nonlinear model.
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
    """Place of the mismatch: a region in words, and for a spot in the flesh its centre and radius."""

    region: str
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Normalised force residual on held-out grasps: without the effect, with it, and by noise alone."""

    rms_before: float
    rms_after: float
    noise_rms: float


@dataclass(frozen=True, kw_only=True)
class GraspTrace:
    """One recording by the fit of the *others*: force on the pads over the indentation of the flesh.

    `given_mm`: measured mean approach of the pads' markers; `before_mm`, `after_mm`: that of the models
    without and with the effect under the measured force. Per frame in contact; `phase` as in the recording.
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
    """Secant modulus of one grasp, pad and frame; the table shows when and where the model fails."""

    grasp: str
    pad: str
    time_s: float
    phase: str
    E_MPa: float
    E_sd_MPa: float


@dataclass(frozen=True, kw_only=True)
class FruitMap:
    """Maps on the fruit's skin, one number per vertex, each divided by its own noise (standard scores).

    `modulus_score`: negative where softer, positive where stiffer flesh below would explain the residual.
    `visible`: signal-to-noise ratio of a spot of soft flesh there; below three is the blind zone.
    """

    vertices_mm: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]
    modulus_score: Float[np.ndarray, " n"]
    visible: Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """The answer. `verdict`: "none", "unknown", one effect, or several that the data cannot separate.

    `statistics`: each detection statistic's own p-value; `p_nominal`: their assumption if they are not
    calibrated, otherwise None. `notes`: sentences a reader must know (one grasp only, the category's pit
    used). `next_grasp`: what to record next, None if there is nothing to separate. `withheld`: why no E is
    given (for a bare indenter's curve). E is then not a number in `before` and `after`, and absent from
    `ranking`. `left_out`: indices of recordings that do not belong to the others; the first notes say why.
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
